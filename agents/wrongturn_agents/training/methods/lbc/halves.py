"""Both halves of a run.

In the first one the privileged agent learns the rule expert's waypoints. In the second one the agent with a camera
learns what the privileged agent tells, and drives to learn more.
"""

from typing import Any

import torch
from torch import Tensor

from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.branches import COMMANDS
from wrongturn_agents.models.lbc import PrivilegedAgent, SensorimotorAgent, WaypointAgent, commanded
from wrongturn_agents.models.waypoints import SIZE, to_picture
from wrongturn_agents.training.held_out import Evaluation
from wrongturn_agents.training.methods.lbc.cars import Cars
from wrongturn_agents.training.methods.lbc.config import PRIVILEGED, LBCConfig
from wrongturn_agents.training.methods.lbc.expert import plan
from wrongturn_agents.training.methods.lbc.half import Half
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import BEST

PRIVILEGED_FILE = "privileged.pt"
_SPEED = 0.2
"""Standard deviation of the speeds' change, as a share."""


class PrivilegedHalf(Half):
    """The expert drives. Of each observation there are samples with the car moved and turned, as in the paper."""

    name, number, file, curve, pictures = PRIVILEGED, 0, PRIVILEGED_FILE, "privileged.csv", False

    def teach(self, seen: dict[str, Tensor], share: float) -> tuple[dict[str, Tensor], Tensor, Tensor]:  # noqa: ARG002
        """Return the expert's waypoints as samples, and to drive by; all cars may be disturbed."""
        cars, config = self.cars, self.config
        copies = [seen, *(moved(seen, config, self.generator) for _ in range(config.shifts))]
        many = {name: torch.cat([one[name] for one in copies]) for name in seen}
        waypoints = plan(cars.situation(many, copies=len(copies)))
        samples = {**{name: many[name] for name in PrivilegedAgent.keys}, "waypoints": waypoints}
        return samples, waypoints[: cars.count], torch.ones(cars.count, dtype=torch.bool, device=cars.device)

    def loss(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the mean error of the commanded waypoints, metres."""
        with self.learner.precision():
            found = self.learner.live(batch)
        return (commanded(found, batch["command"]).float() - batch["waypoints"]).abs().mean()


class SensorimotorHalf(Half):
    """At first the teacher drives. Then the agent drives most of the cars, in rounds: each begins with a copy of it."""

    name, number, file, curve, pictures = "lbc", 1, BEST, "progress.csv", True

    def __init__(self, run: Run, agent: WaypointAgent, teacher: WaypointAgent) -> None:
        super().__init__(run, agent)
        self._teacher = teacher
        self._augmentation = Augmentation().to(run.device)
        self._driving = SensorimotorAgent(self.config.width).to(run.device).eval().requires_grad_(False)
        self._round = 0

    def teach(self, seen: dict[str, Tensor], share: float) -> tuple[dict[str, Tensor], Tensor, Tensor]:
        """Return the teacher's points as samples. All cars drive by the teacher, or most of them by the agent."""
        if (number := round_of(share, self.config)) > self._round:
            self._driving.load_state_dict(self.learner.average.state_dict())
            self._round = number
        cars = self.cars
        with self.learner.precision():
            waypoints, points, weights = taught(self._teacher, cars, seen, white_box=self.config.white_box)
            guided = round(self.config.guided * cars.count) if self._round else cars.count
            by_teacher = torch.arange(cars.count, device=cars.device) < guided
            if self._round:
                own = commanded(self._driving(seen), seen["command"]).float()
                waypoints = torch.where(by_teacher[:, None, None], waypoints, own)
        return (
            {**{name: seen[name] for name in SensorimotorAgent.keys}, "points": points, "weights": weights},
            waypoints,
            by_teacher,
        )

    def loss(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the mean distance of the points in the picture, pixels."""
        if self.config.augment:
            batch["rgb"] = self._augmentation(batch["rgb"])
        with self.learner.precision():
            found = self.learner.live.points(batch)  # type: ignore[operator]
        return picture_loss(found, batch["points"], batch["weights"])

    def evaluate_now(self, share: float) -> Evaluation | None:
        """Drive held-out journeys as often as the settings say."""
        if share >= 1.0 or share - self._evaluated < 1.0 / self.config.evaluations:
            return None
        self._evaluated = share
        return self.evaluate()

    def row(self, evaluation: Evaluation | None, **figures: Any) -> None:
        """Write a row with the number of DAgger's round."""
        share = self.run.budget.fraction(self.learner.seen)
        super().row(evaluation, round=round_of(share, self.config), **figures)


def taught(
    privileged: WaypointAgent, cars: Cars, seen: dict[str, Tensor], *, white_box: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return what the agent with a camera should tell.

    With ``white_box`` these are the privileged agent's for all commands, else the expert's for the one that is given.

    Returns:
        waypoints: (n, 5, 2) to drive by.
        points: (n, 4, 5, 2) in the picture, to learn for each command.
        weights: (n, 4): 0 for commands that do not count.
    """
    if white_box:
        waypoints = privileged(seen).float()
        weights = torch.ones(waypoints.shape[:2], device=waypoints.device)
        return commanded(waypoints, seen["command"]), to_picture(waypoints), weights
    planned = plan(cars.situation(seen))
    numbers = torch.arange(1, len(COMMANDS) + 1, device=planned.device)
    points = to_picture(planned)[:, None].expand(-1, len(COMMANDS), -1, -1)
    return planned, points, (seen["command"] == numbers).float()


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


def moved(seen: dict[str, Tensor], config: LBCConfig, generator: torch.Generator) -> dict[str, Tensor]:
    """Return an observation with the cars moved to the side and turned, and with other speeds."""
    pose, speed = seen["pose"].clone(), seen["speed"]
    draws = torch.randn(3, len(pose), generator=generator, device=pose.device)
    aside, turn = config.shift * draws[0], config.turn * draws[1]
    pose[:, 0] -= aside * pose[:, 2].sin()
    pose[:, 1] += aside * pose[:, 2].cos()
    pose[:, 2] += turn
    return {**seen, "pose": pose, "speed": (speed * (1.0 + _SPEED * draws[2][:, None])).clamp_min(0.0)}
