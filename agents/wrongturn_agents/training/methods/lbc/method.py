"""Learning by Cheating as a training method: a privileged agent first, then one with a camera that learns from it."""

from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from wrongturn_agents.models.lbc import PrivilegedAgent, SensorimotorAgent, WaypointAgent
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.checkpoint import read
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.held_out import Evaluation
from wrongturn_agents.training.method import Method, TrainedAgent, load
from wrongturn_agents.training.methods.averaging import AveragedLearner
from wrongturn_agents.training.methods.lbc.config import PRIVILEGED, LBCConfig
from wrongturn_agents.training.methods.lbc.privileged import PrivilegedHalf
from wrongturn_agents.training.methods.lbc.sensorimotor import SensorimotorHalf, Teacher, round_of
from wrongturn_agents.training.methods.wandering import Pool
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import BEST

PRIVILEGED_FILE: Final = "privileged.pt"
_ROWS: Final = 100
"""Rows of a half."""
_MOST_RESERVED: Final = 0.2
"""Greatest share of the minutes that the privileged agent's evaluation gets."""
_CLASSES: Final[dict[str, type[WaypointAgent]]] = {"lbc": SensorimotorAgent, PRIVILEGED: PrivilegedAgent}


class LbcMethod(Method):
    """Learning by Cheating (Chen et al., CoRL 2019)."""

    settings = LBCConfig
    agents = tuple(
        TrainedAgent(name, SHIPPED_AGENTS[name].track, tuple(kind.keys), SHIPPED_AGENTS[name].description)
        for name, kind in _CLASSES.items()
    )
    unit = "samples"
    columns = (
        *("step", "minutes", "loss", "collected", "round"),
        *("off_road", "collision", "wrong_way", "not_engaged", "timeout"),
        *("success_heldout", "clean_heldout", "reward_heldout", "traffic_success_heldout"),
        *("steps_per_second", "learning_rate"),
    )
    """Steps are samples that were learned from. The loss is in metres or, in ``progress.csv``, in pixels. Verdicts are
    shares of the drives that ended while samples were collected; one that did not fail ended by its ``timeout``."""

    def build(self, settings: LBCConfig, algorithm: str, *, seed: int | None = None) -> WaypointAgent:
        """Return an untrained agent."""
        with torch.random.fork_rng(devices=[], enabled=seed is not None):
            if seed is not None:
                torch.manual_seed(seed)
            return _CLASSES[algorithm](settings.width)  # type: ignore[call-arg]

    def prepare(self, settings: LBCConfig) -> bytes | None:
        """Return the file of the privileged agent that the settings name."""
        if not settings.teacher:
            return None
        file, wanted = Path(settings.teacher), "the privileged.pt of a run of lbc"
        found = read(file, "teacher", wanted)
        algorithm = found.get("algorithm") if isinstance(found, dict) else None
        if algorithm != PRIVILEGED:
            raise TrainingError(f"teacher {file}: is {f'of {algorithm}' if algorithm else 'no agent'}; name {wanted}")
        load(file)  # checks the rest
        return file.read_bytes()

    def learn(self, run: Run) -> None:
        """Train the privileged agent and the one with a camera, or the latter alone."""
        config: LBCConfig = run.settings
        torch.manual_seed(run.seed)
        privileged, student = (
            self.build(config, name).to(run.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
            for name in (PRIVILEGED, self.name)
        )
        if run.given is not None:
            (run.folder / PRIVILEGED_FILE).write_bytes(run.given)
        if not config.teacher and (run.state is None or run.state["half"] == PRIVILEGED):
            _first(run, config, AveragedLearner(privileged, config))
        teacher: Any = load(run.folder / PRIVILEGED_FILE, run.device).model
        teacher.requires_grad_(False).to(memory_format=torch.channels_last)
        _second(run, config, AveragedLearner(student, config), teacher)


METHOD: Final = LbcMethod()


def _first(run: Run, config: LBCConfig, learner: AveragedLearner) -> None:
    """Train the privileged agent with its share of the run's budget, and give the rest back."""
    steps, minutes = run.begun.steps, run.begun.minutes
    own = None if minutes is None else minutes * config.privileged_share
    samples = config.privileged_samples if minutes is None or steps is not None else None
    run.budget = Budget(samples, own, used=run.budget.used)
    run.budget.reserve = 0.0  # its evaluation is a short one, and the other half has time left
    half = _Half(run, PRIVILEGED, learner)
    half.learn(PrivilegedHalf(config, learner, seed=run.stream(0, learner.seen), threads=run.threads))
    # The half's own minutes are used up by now. Its evaluation takes some of the other half's.
    end = None if minutes is None else minutes * min(1.0, config.privileged_share + _MOST_RESERVED)
    clock = Budget(samples, end, used=run.budget.used)
    evaluation = half.evaluate(track="privileged", stop=clock.out_of_time)
    half.row(evaluation)
    half.save(PRIVILEGED_FILE, evaluation)
    run.budget, run.state = Budget(steps, minutes, used=run.budget.used), None


def _second(run: Run, config: LBCConfig, learner: AveragedLearner, teacher: WaypointAgent) -> None:
    """Train the agent with a camera."""
    half = _Half(run, "lbc", learner)
    half.learn(
        SensorimotorHalf(
            config, learner, Teacher(teacher, white_box=config.white_box), seed=run.stream(1, learner.seen),
            threads=run.threads,
        )
    )  # fmt: skip
    if half.learned:  # an interrupted evaluation is driven again on --resume
        half.save(BEST, None)
        half.save_state()
    evaluation = half.evaluate(last=True)
    half.row(evaluation)
    if half.learned or evaluation is not None:  # a finished run that is resumed without time left keeps what it has
        half.save(BEST, evaluation)
    half.save_state()


class _Half:
    """One half of a run: what learns, and when it reports, is evaluated and saved."""

    def __init__(self, run: Run, name: str, learner: AveragedLearner) -> None:
        self._run, self._name, self._learner = run, name, learner
        self.learned = False
        if run.state is not None:
            learner.restore(run)
        run.open(learner.seen, file="privileged.csv" if name == PRIVILEGED else "progress.csv", part=name)
        self._shown = self._evaluated = run.budget.fraction(learner.seen)
        self._samples = Pool(run.settings.buffer)

    def learn(self, half: PrivilegedHalf | SensorimotorHalf) -> None:
        """Collect samples and learn from them, until the budget is over."""
        run, learner, config, samples = self._run, self._learner, self._run.settings, self._samples
        begun = learner.seen
        try:
            while not run.over(learner.seen):
                share = run.budget.fraction(learner.seen)
                if len(samples) < config.begin or learner.seen - begun >= config.uses * samples.added:
                    half.collect(samples, share)
                    continue
                if learner.seen == 0:
                    run.budget.begun = run.budget.used  # compiling and the first samples do not count
                self._loss: Tensor = half.loss(samples.draw(config.batch_size))
                learner.learn(self._loss, config.batch_size, share)
                self.learned = True
                run.drove({"verdict": verdict} for verdict in half.cars.ended)
                half.cars.ended.clear()
                self._report()
                if run.budget.out_of_time():
                    return
        finally:
            half.cars.close()

    def _report(self) -> None:
        """Write a row, evaluate and save when it is time."""
        run, share = self._run, self._run.budget.fraction(self._learner.seen)
        evaluation = None
        second = self._name != PRIVILEGED
        if second and share < 1.0 and share - self._evaluated >= 1.0 / run.settings.evaluations:
            self._evaluated = share
            evaluation = self.evaluate()
        if evaluation is not None or share - self._shown >= 1.0 / _ROWS:
            self._shown = share
            self.row(evaluation)
        if evaluation is not None or run.save_due:
            self.save_state()
            if second:
                self.save(BEST, evaluation)

    def evaluate(self, **options: Any) -> Evaluation | None:
        """Drive held-out journeys with the average of the weights."""
        found = self._run.evaluate([self._learner.average], **options)  # type: ignore[list-item]
        return found[0] if found else None

    def row(self, evaluation: Evaluation | None) -> None:
        """Write a row, if anything has been learned since the half was begun or resumed."""
        if self.learned:
            share = self._run.budget.fraction(self._learner.seen)
            self._run.row(
                self._learner.seen,
                evaluation,
                loss=self._loss.item(),
                collected=self._samples.added,
                round=None if self._name == PRIVILEGED else round_of(share, self._run.settings),
                learning_rate=self._learner.rate,
            )

    def save(self, file: str, evaluation: Evaluation | None) -> None:
        """Write the average of the weights, in half precision, as it is shipped."""
        seen = self._learner.seen
        self._run.save(file, self._learner.average, seen, evaluation, algorithm=self._name, halved=True)

    def save_state(self) -> None:
        """Write what the half continues from; samples are collected anew."""
        self._run.save_state(half=self._name, learner=self._learner.state())
