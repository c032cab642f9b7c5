"""The second half: the agent with a camera learns what the privileged agent tells, and drives to learn more."""

import torch
from torch import Tensor

from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.lbc import COMMANDS, SensorimotorAgent, WaypointAgent, commanded
from wrongturn_agents.models.waypoints import SIZE, to_picture
from wrongturn_agents.training.methods.averaging import AveragedLearner
from wrongturn_agents.training.methods.lbc.cars import Cars
from wrongturn_agents.training.methods.lbc.config import LBCConfig
from wrongturn_agents.training.methods.lbc.driving import Drivers, told
from wrongturn_agents.training.methods.lbc.expert import plan
from wrongturn_agents.training.methods.wandering import Pool

_SEEN = ("rgb", "speed", "command")


class Teacher:
    """Tells what the agent with a camera should tell: the privileged agent's waypoints, or the expert's.

    Args:
        white_box: teach its waypoints for all commands; else the expert's for the one that is given.
    """

    def __init__(self, privileged: WaypointAgent, *, white_box: bool) -> None:
        self._privileged = privileged
        self._white_box = white_box

    def teach(self, cars: Cars, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Return waypoints to drive by (n, 5, 2), points in the picture to learn (n, 4, 5, 2), and weights (n, 4)."""
        if self._white_box:
            waypoints = self._privileged(seen).float()
            weights = torch.ones(waypoints.shape[:2], device=waypoints.device)
            return commanded(waypoints, seen["command"]), to_picture(waypoints), weights
        planned = plan(cars.situation(seen))
        numbers = torch.arange(1, len(COMMANDS) + 1, device=planned.device)
        points = to_picture(planned)[:, None].expand(-1, len(COMMANDS), -1, -1)
        return planned, points, (seen["command"] == numbers).float()


class SensorimotorHalf:
    """What the agent with a camera learns from.

    At first the teacher drives. Then the agent drives most of the cars, in rounds: each begins with a copy of it.
    """

    def __init__(
        self, config: LBCConfig, learner: AveragedLearner, teacher: Teacher, *, seed: int, threads: int
    ) -> None:
        self._config, self._learner, self._teacher = config, learner, teacher
        generator = torch.Generator(learner.device).manual_seed(seed)
        self._augmentation = Augmentation().to(learner.device)
        self.cars = Cars(config.num_envs, config, seed=seed, pictures=True, device=learner.device, threads=threads)
        self._drivers = Drivers(config.num_envs, config, generator)
        self._driving = SensorimotorAgent(config.width).to(learner.device).eval().requires_grad_(False)
        self._round = 0

    @torch.no_grad()
    def collect(self, samples: Pool, share: float) -> None:
        """Add samples of what the cars see, and drive on: all by the teacher, or most of them by the agent."""
        if (number := round_of(share, self._config)) > self._round:
            self._driving.load_state_dict(self._learner.average.state_dict())
            self._round = number
        cars = self.cars
        seen = cars.observe()
        with self._learner.precision():
            waypoints, points, weights = self._teacher.teach(cars, seen)
            guided = round(self._config.guided * cars.count) if self._round else cars.count
            by_teacher = torch.arange(cars.count, device=cars.device) < guided
            if self._round:
                waypoints = torch.where(by_teacher[:, None, None], waypoints, told(self._driving, seen))
        samples.add({**{name: seen[name] for name in _SEEN}, "points": points, "weights": weights})
        action = self._drivers.act(waypoints, seen["speed"], by_teacher)
        self._drivers.begin(torch.from_numpy(cars.step(action)).to(cars.device))

    def loss(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the mean distance of the points in the picture, pixels."""
        if self._config.augment:
            batch["rgb"] = self._augmentation(batch["rgb"])
        with self._learner.precision():
            found = self._learner.live.points(batch)  # type: ignore[operator]
        return picture_loss(found, batch["points"], batch["weights"])


def round_of(share: float, config: LBCConfig) -> int:
    """Return the number of DAgger's round in which a share of the learning is over; 0 before the first."""
    if config.rounds == 0 or share < config.offline:
        return 0
    return min(config.rounds, 1 + int((share - config.offline) / max(1.0 - config.offline, 1e-9) * config.rounds))


def picture_loss(found: Tensor, wanted: Tensor, weights: Tensor) -> Tensor:
    """Return the mean distance of points in the picture along rows and columns, pixels.

    Args:
        found: (n, 4, 5, 2), -1 to 1.
        wanted: (n, 4, 5, 2).
        weights: (n, 4): 0 for commands that do not count.
    """
    half = torch.tensor(SIZE, device=found.device) / 2.0
    pixels = ((found.float() - wanted).abs() * half).mean((2, 3))
    return (pixels * weights).sum() / weights.sum().clamp_min(1.0)
