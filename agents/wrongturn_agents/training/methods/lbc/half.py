"""One half of a run: its cars, what it learns from them, and when it reports, is evaluated and saved."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Final

import torch
from torch import Tensor

from wrongturn_agents.models.lbc import WaypointAgent
from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl
from wrongturn_agents.training.held_out import Evaluation
from wrongturn_agents.training.methods.averaging import AveragedLearner
from wrongturn_agents.training.methods.lbc.cars import Cars
from wrongturn_agents.training.methods.lbc.config import LBCConfig
from wrongturn_agents.training.methods.pool import Pool
from wrongturn_agents.training.run import Run

_ROWS: Final = 100
"""Rows of a half."""
_LASTING: Final = 0.9
"""Share of a disturbance of the steering that is left after a decision."""


class Half(ABC):
    """What both halves have in common. An interrupted one goes on from its run's state, with new samples."""

    name: ClassVar[str]
    """Algorithm of the agent that learns."""
    number: ClassVar[int]
    file: ClassVar[str]
    """File of the run that gets the agent."""
    curve: ClassVar[str]
    """File of the run that gets the rows of progress."""
    pictures: ClassVar[bool]
    """Whether it learns from pictures."""

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
        """Return samples of what the cars see, waypoints to drive by, and which cars may be disturbed.

        Args:
            seen: (n, ...) for each key.
            share: how much of the learning is over, from 0 to 1.

        Returns:
            samples: (m, ...) for each key.
            waypoints: (n, 5, 2): where each car should drive.
            disturbed: (n,) bool.
        """

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
