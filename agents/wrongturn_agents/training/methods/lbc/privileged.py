"""The first half: the privileged agent learns the rule expert's waypoints."""

import torch
from torch import Tensor

from wrongturn_agents.models.birdview import KEYS
from wrongturn_agents.models.lbc import commanded
from wrongturn_agents.training.methods.averaging import AveragedLearner
from wrongturn_agents.training.methods.lbc.cars import Cars
from wrongturn_agents.training.methods.lbc.config import LBCConfig
from wrongturn_agents.training.methods.lbc.driving import Drivers
from wrongturn_agents.training.methods.lbc.expert import plan
from wrongturn_agents.training.methods.wandering import Pool

_SPEED = 0.2
"""Standard deviation of the speeds' change, as a share."""
_SEEN = (*KEYS, "speed", "command")


class PrivilegedHalf:
    """What the privileged agent learns from: the expert drives.

    Of each observation there are samples with the car moved and turned, as in the paper.
    """

    def __init__(self, config: LBCConfig, learner: AveragedLearner, *, seed: int, threads: int) -> None:
        self._config, self._learner = config, learner
        self._generator = torch.Generator(learner.device).manual_seed(seed)
        self.cars = Cars(config.num_envs, config, seed=seed, pictures=False, device=learner.device, threads=threads)
        self._drivers = Drivers(config.num_envs, config, self._generator)

    @torch.no_grad()
    def collect(self, samples: Pool, share: float) -> None:  # noqa: ARG002 - the expert always drives
        """Add samples of what the cars see, and let the expert drive on."""
        cars, config = self.cars, self._config
        seen = cars.observe()
        copies = [seen, *(moved(seen, config, self._generator) for _ in range(config.shifts))]
        many = {name: torch.cat([one[name] for one in copies]) for name in seen}
        waypoints = plan(cars.situation(many, copies=len(copies)))
        samples.add({**{name: many[name] for name in _SEEN}, "waypoints": waypoints})
        everyone = torch.ones(cars.count, dtype=torch.bool, device=cars.device)
        action = self._drivers.act(waypoints[: cars.count], seen["speed"], everyone)
        self._drivers.begin(torch.from_numpy(cars.step(action)).to(cars.device))

    def loss(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the mean error of the commanded waypoints, metres."""
        with self._learner.precision():
            found = self._learner.live(batch)
        return (commanded(found, batch["command"]).float() - batch["waypoints"]).abs().mean()


def moved(seen: dict[str, Tensor], config: LBCConfig, generator: torch.Generator) -> dict[str, Tensor]:
    """Return an observation with the cars moved to the side and turned, and with other speeds."""
    pose, speed = seen["pose"].clone(), seen["speed"]
    draws = torch.randn(3, len(pose), generator=generator, device=pose.device)
    aside, turn = config.shift * draws[0], config.turn * draws[1]
    pose[:, 0] -= aside * pose[:, 2].sin()
    pose[:, 1] += aside * pose[:, 2].cos()
    pose[:, 2] += turn
    return {**seen, "pose": pose, "speed": (speed * (1.0 + _SPEED * draws[2][:, None])).clamp_min(0.0)}
