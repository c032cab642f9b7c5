"""Learning by Cheating as a training method: a privileged agent first, then one with a camera that learns from it."""

from pathlib import Path
from typing import Any, Final

import torch

from wrongturn_agents.models.lbc import PrivilegedAgent, SensorimotorAgent, WaypointAgent
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.checkpoint import read
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import Method, TrainedAgent, load
from wrongturn_agents.training.run import Run
from wrongturn_lbc.config import PRIVILEGED, LBCConfig
from wrongturn_lbc.halves import PRIVILEGED_FILE, PrivilegedHalf, SensorimotorHalf

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

    def build(self, settings: LBCConfig, algorithm: str) -> WaypointAgent:
        """Return an untrained agent."""
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
        privileged, student = (_placed(self.build(run.settings, name), run) for name in (PRIVILEGED, self.name))
        if run.given is not None:
            (run.folder / PRIVILEGED_FILE).write_bytes(run.given)
        elif run.state is None or run.state["half"] == PRIVILEGED:
            _first(run, privileged)
        teacher: Any = load(run.folder / PRIVILEGED_FILE, run.device).model
        _second(run, student, _placed(teacher.requires_grad_(False), run))


METHOD: Final = LbcMethod()


def _placed(agent: Any, run: Run) -> Any:
    return agent.to(run.device, memory_format=torch.channels_last)


def _first(run: Run, agent: WaypointAgent) -> None:
    """Train the privileged agent with its share of the run's budget, and give the rest back."""
    steps, minutes = run.begun.steps, run.begun.minutes
    samples = run.settings.privileged_samples if minutes is None or steps is not None else None
    run.budget = Budget(samples, minutes, used=run.budget.used)
    run.budget.reserve = 0.0  # its evaluation is a short one, and the other half has time left
    half = PrivilegedHalf(run, agent)
    half.learn()
    if half.learner.seen == 0:
        raise TrainingError(f"minutes: were over before {half.name} learned anything; begin again with more --minutes")
    # The half's own minutes may be over by now. Its evaluation takes some of the other half's.
    own = run.budget.seconds
    end = None if minutes is None or own is None else min(minutes, own / 60.0 + _MOST_RESERVED * minutes)
    clock = Budget(samples, end, used=run.budget.used)
    evaluation = half.evaluate(track="privileged", stop=clock.out_of_time)
    half.row(evaluation)
    half.save(evaluation)
    run.budget, run.state = Budget(steps, minutes, used=run.budget.used), None


def _second(run: Run, agent: WaypointAgent, teacher: WaypointAgent) -> None:
    """Train the agent with a camera."""
    half = SensorimotorHalf(run, agent, teacher)
    half.learn()
    if half.learner.seen == 0:
        half.save_state()
        raise TrainingError(f"minutes: were over before {half.name} learned anything; give --resume and more --minutes")
    if half.learned:  # an interrupted evaluation is driven again on --resume
        half.save(None)
        half.save_state()
    evaluation = half.evaluate(last=True)
    half.row(evaluation)
    # A finished run that is resumed without time left keeps what it has.
    if half.learned or evaluation is not None or not (run.folder / half.file).is_file():
        half.save(evaluation)
    half.save_state()
