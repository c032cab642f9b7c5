"""How far cars get that an agent drives, in drives that no training sees; and whether its file drives alike."""

import numpy as np
import torch

from wrongturn_agents.models.actor_critic import controls
from wrongturn_lbc.cars import Cars
from wrongturn_lbc.config import LBCConfig

CARS = 32
_HELD_OUT = 10**6


def by_chance(actions=None):
    """Drive by random actions, or by those of a table (n, 2): steer and accelerate."""
    random = torch.Generator().manual_seed(1)

    def act(_, memory):
        if actions is None:
            return controls(2.0 * torch.rand(CARS, 2, generator=random) - 1.0), memory
        return controls(actions[torch.randint(len(actions), (CARS,), generator=random)]), memory

    return act


@torch.inference_mode()
def metres(act, memory=None, *, pictures=False):
    """Return how far 32 cars get in 5 s before they fail, on average.

    Args:
        act: returns steer, throttle and brake (32, 3) and the new memory, of an observation and the memory.
        memory: the first memory.
        pictures: show what the cameras see.
    """
    cars = Cars(
        CARS, LBCConfig(traffic=0.0, time_limit=6.0), seed=_HELD_OUT, pictures=pictures, device=torch.device("cpu")
    )
    alive, driven = np.ones(CARS, bool), np.zeros(CARS)
    for _ in range(50):
        seen = cars.observe()
        driven += 0.1 * seen["speed"][:, 0].numpy() * alive
        action, memory = act(seen, memory)
        alive[cars.step(action)] = False
    cars.close()
    return driven.mean()


@torch.inference_mode()
def alike(model, driver, observations, tolerance):
    """Return on how many observations, one after the other, a file's agent does what a network with a memory does."""
    driver.reset(None)
    memory, same = model.begin(1), 0
    for i in range(len(observations["speed"])):
        action = driver.act({key: array[i] for key, array in observations.items()})
        seen = {key: torch.from_numpy(array[i : i + 1]) for key, array in observations.items()}
        wanted, memory = model.drive_on(seen, memory)
        same += np.allclose((action.steer, action.throttle, action.brake), wanted[0].numpy(), atol=tolerance)
    return same
