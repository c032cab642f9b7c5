"""The first half: the privileged agent learns the rule expert's waypoints."""

from collections.abc import Callable

import torch
from torch import Tensor

from wrongturn_agents.models.birdview import KEYS
from wrongturn_agents.models.lbc import commanded
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.lbc.cars import Cars
from wrongturn_agents.training.lbc.config import LBCConfig
from wrongturn_agents.training.lbc.driving import Drivers
from wrongturn_agents.training.lbc.expert import plan
from wrongturn_agents.training.lbc.learning import Learner, Samples, precision

_SPEED = 0.2
"""Standard deviation of the speeds' change, as a share."""
_SEEN = (*KEYS, "speed", "command")


def learn_privileged(
    learner: Learner,
    config: LBCConfig,
    *,
    seed: int,
    budget: Budget,
    threads: int = 1,
    on_update: Callable[[Tensor, int, list[str]], bool],
) -> None:
    """Teach the privileged agent until the budget is over.

    The expert drives. Of each observation there are samples with the car moved and turned, as in the paper.

    Args:
        learner: the agent.
        config: settings.
        seed: seed of the drives and of all that is drawn.
        budget: samples (its steps) and minutes.
        threads: threads of the simulation.
        on_update: called after each update with the loss, the number of samples collected, and the verdicts of drives
            that ended; False ends the learning.
    """
    device = learner.device
    generator = torch.Generator(device).manual_seed(seed)
    cars = Cars(config.num_envs, config, seed=seed, pictures=False, device=device, threads=threads)
    drivers = Drivers(config.num_envs, config, generator)
    samples = Samples(config.buffer)
    begun = learner.seen
    try:
        while not budget.over(learner.seen):
            if len(samples) < config.begin or learner.seen - begun >= config.uses * samples.added:
                _collect(cars, drivers, samples, config, generator)
                continue
            if learner.seen == 0:
                budget.begun = budget.used  # compiling and the first samples do not count
            batch = samples.draw(config.batch_size)
            with precision(config, device):
                found = learner.live(batch)
            loss = (commanded(found, batch["command"]).float() - batch["waypoints"]).abs().mean()
            learner.learn(loss, config.batch_size, budget.fraction(learner.seen))
            if not on_update(loss, samples.added, cars.ended):
                return
    finally:
        cars.close()


@torch.no_grad()
def _collect(cars: Cars, drivers: Drivers, samples: Samples, config: LBCConfig, generator: torch.Generator) -> None:
    """Add samples of what the cars see, and let the expert drive on."""
    seen = cars.observe()
    copies = [seen, *(moved(seen, config, generator) for _ in range(config.shifts))]
    many = {name: torch.cat([one[name] for one in copies]) for name in seen}
    waypoints = plan(cars.situation(many, copies=len(copies)))
    samples.add({**{name: many[name] for name in _SEEN}, "waypoints": waypoints})
    everyone = torch.ones(cars.count, dtype=torch.bool, device=cars.device)
    action = drivers.act(waypoints[: cars.count], seen["speed"], everyone)
    drivers.begin(torch.from_numpy(cars.step(action)).to(cars.device))


def moved(seen: dict[str, Tensor], config: LBCConfig, generator: torch.Generator) -> dict[str, Tensor]:
    """Return an observation with the cars moved to the side and turned, and with other speeds."""
    pose, speed = seen["pose"].clone(), seen["speed"]
    draws = torch.randn(3, len(pose), generator=generator, device=pose.device)
    aside, turn = config.shift * draws[0], config.turn * draws[1]
    pose[:, 0] -= aside * pose[:, 2].sin()
    pose[:, 1] += aside * pose[:, 2].cos()
    pose[:, 2] += turn
    return {**seen, "pose": pose, "speed": (speed * (1.0 + _SPEED * draws[2][:, None])).clamp_min(0.0)}
