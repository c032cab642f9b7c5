"""Both halves of a run.

In the first one the privileged agent learns the rule expert's waypoints. In the second one the agent with a camera
learns what the privileged agent tells, and drives to learn more.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Final

import torch
from torch import Tensor

from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.branches import COMMANDS
from wrongturn_agents.models.lbc import PrivilegedAgent, SensorimotorAgent, WaypointAgent, commanded
from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl
from wrongturn_agents.models.waypoints import SIZE, to_picture
from wrongturn_agents.training.held_out import Evaluation
from wrongturn_agents.training.methods.averaging import AveragedLearner, Pool
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import BEST
from wrongturn_lbc.cars import Cars
from wrongturn_lbc.config import PRIVILEGED, LBCConfig
from wrongturn_lbc.expert import plan

_ROWS: Final = 100
"""Rows of a half."""
_LASTING: Final = 0.9
"""Share of a disturbance of the steering that is left after a decision."""
PRIVILEGED_FILE = "privileged.pt"
_SPEED = 0.2
"""Standard deviation of the speeds' change, as a share."""


class Half(ABC):
    """What both halves have in common. An interrupted one goes on from its run's state, with new samples."""

    name: ClassVar[str]
    """Algorithm of the agent that learns, which the run's ``file`` gets; ``curve`` gets the rows of progress."""
    number: ClassVar[int]
    file: ClassVar[str]
    curve: ClassVar[str]
    pictures: ClassVar[bool]

    def __init__(self, run: Run, agent: WaypointAgent) -> None:
        config: LBCConfig = run.settings
        self.run, self.config = run, config
        self.learner = AveragedLearner(agent, config)
        self.learned = False
        """Whether anything has been learned since the half was begun or resumed."""
        if run.state is not None:
            self.learner.restore(run)
        seen, count, device = self.learner.seen, config.num_envs, run.device
        run.open(seen, file=self.curve, part=self.name)
        if seen:
            self._limit()
        self._shown = self._evaluated = run.budget.fraction(seen)
        seed = run.stream(self.number, seen)
        self.generator = torch.Generator(device).manual_seed(seed)
        self.samples = Pool(config.buffer)
        self.cars = Cars(count, config, seed=seed, pictures=self.pictures, device=device, threads=run.threads)
        self._control = WaypointControl()
        self._memory = torch.zeros(count, MEMORY, device=device)
        self._noise = torch.zeros(count, device=device)
        self._noisy = torch.zeros(count, dtype=torch.bool, device=device)
        self._begin(torch.arange(count, device=device))

    @abstractmethod
    def teach(self, seen: dict[str, Tensor], share: float) -> tuple[dict[str, Tensor], Tensor, Tensor]:
        """Return samples of what the cars see, (n, ...) for each key, when a share of the learning is over.

        Returns:
            samples: (m, ...) for each key.
            waypoints: (n, 5, 2): where each car should drive.
            disturbed: (n,) bool.
        """

    @property
    def minutes_share(self) -> float:
        """Share of the minutes that are left when the half begins to learn, for its learning."""
        return 1.0

    def _limit(self) -> None:
        budget = self.run.budget
        if budget.seconds is not None:
            budget.seconds = budget.begun + self.minutes_share * max(0.0, budget.seconds - budget.begun)

    @abstractmethod
    def loss(self, batch: dict[str, Tensor]) -> Tensor:
        """Return the mean loss of a minibatch of samples."""

    def learn(self) -> None:
        """Collect samples and learn from them, until the budget is over."""
        run, learner, config, samples = self.run, self.learner, self.config, self.samples
        begun = learner.seen
        try:
            while not run.over(learner.seen):
                share = run.budget.fraction(learner.seen)
                if len(samples) < config.begin or learner.seen - begun >= config.uses * samples.added:
                    self._collect(share)
                    continue
                if learner.seen == 0:
                    run.budget.begun = run.budget.used  # compiling and the first samples do not count
                    self._limit()
                self._loss: Tensor = self.loss(samples.draw(config.batch_size))
                learner.learn(self._loss, config.batch_size, share)
                self.learned = True
                run.drove({"verdict": verdict} for verdict in self.cars.ended)
                self.cars.ended.clear()
                self._report()
                if run.budget.out_of_time():
                    return
        finally:
            self.cars.close()

    def evaluate(self, **options: Any) -> Evaluation | None:
        """Drive held-out journeys with the average of the weights."""
        found = self.run.evaluate([self.learner.average], **options)  # type: ignore[list-item]
        return found[0] if found else None

    def row(self, evaluation: Evaluation | None, **figures: Any) -> None:
        """Write a row, if anything has been learned."""
        if self.learned:
            figures |= {"collected": self.samples.added, "learning_rate": self.learner.rate}
            self.run.row(self.learner.seen, evaluation, loss=self._loss.item(), **figures)

    def save(self, evaluation: Evaluation | None) -> None:
        """Write the average of the weights, in half precision, as it is shipped."""
        average, seen = self.learner.average, self.learner.seen
        self.run.save(self.file, average, seen, evaluation, algorithm=self.name, halved=True)

    def save_state(self) -> None:
        """Write what the half continues from."""
        self.run.save_state(half=self.name, learner=self.learner.state())

    def _report(self) -> None:
        """Write a row and save when it is time."""
        share = self.run.budget.fraction(self.learner.seen)
        evaluation = self.evaluate_now(share)
        if evaluation is not None or share - self._shown >= 1.0 / _ROWS:
            self._shown = share
            self.row(evaluation)
        if evaluation is not None or self.run.save_due:
            self.save_state()
            self.save(evaluation)

    def evaluate_now(self, share: float) -> Evaluation | None:  # noqa: ARG002
        """Drive held-out journeys if it is time; None if not."""
        return None

    @torch.no_grad()
    def _collect(self, share: float) -> None:
        """Add samples of what the cars see, and drive on."""
        seen = self.cars.observe()
        samples, waypoints, disturbed = self.teach(seen, share)
        self.samples.add(samples)
        action, self._memory = self._control(waypoints, seen["speed"], self._memory)
        drawn = torch.randn(self._noise.shape, generator=self.generator, device=self._noise.device)
        self._noise = _LASTING * self._noise + self.config.noise * (1.0 - _LASTING**2) ** 0.5 * drawn
        action[:, 0] += torch.where(disturbed & self._noisy, self._noise, 0.0)
        self._begin(torch.from_numpy(self.cars.step(action.clamp(-1.0, 1.0))).to(self._noise.device))

    def _begin(self, cars: Tensor) -> None:
        """Forget the last drives of some cars, and draw which of them are disturbed."""
        self._memory[cars], self._noise[cars] = 0.0, 0.0
        chances = torch.rand(len(cars), generator=self.generator, device=cars.device)
        self._noisy[cars] = chances < self.config.noisy


class PrivilegedHalf(Half):
    """The expert drives. Of each observation there are samples with the car moved and turned, as in the paper."""

    name, number, file, curve, pictures = PRIVILEGED, 0, PRIVILEGED_FILE, "privileged.csv", False

    @property
    def minutes_share(self) -> float:
        """As the settings say."""
        return self.config.privileged_share

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
    """Return the mean distance along rows and columns of points (n, 4, 5, 2) in the picture, -1 to 1, in pixels.

    Weights (n, 4) are 0 for commands that do not count.
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
