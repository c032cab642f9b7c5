"""A training run: its budget, what it continues from, its held-out journeys, and everything that it leaves.

``train("ppo-segmentation", directory=...)`` begins one, as ``wrongturn train`` does. A method gets a :class:`Run`.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from torch import nn

from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.cars import VERDICTS
from wrongturn_agents.training.checkpoint import load_checkpoint, save_checkpoint, write
from wrongturn_agents.training.devices import check_threads, device_of, memory_named, prepare
from wrongturn_agents.training.drive import AnyModel
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.held_out import (
    Candidate,
    Candidates,
    Evaluation,
    held_out_journeys,
    longest,
    shortest,
    with_traffic,
)
from wrongturn_agents.training.job import STATE
from wrongturn_agents.training.method import Method, find_method
from wrongturn_agents.training.progress import ProgressFile, Row
from wrongturn_agents.training.run_directory import (
    BEST,
    ENCODER,
    LAST,
    Begun,
    check_resumed,
    check_seed,
    held,
    read_state,
)
from wrongturn_agents.training.stopping import Stop
from wrongturn_agents.training.world import MEETING, held_out_towns
from wrongturn_networks import Town
from wrongturn_sim import FleetTraffic

_EPISODES: Final = 100
"""Drives over which the training reward is averaged."""
_LATE: Final = 0.93
"""Share of a run after which only the last evaluation is left."""
_FIGURES: Final = ("success", "clean", "reward", "traffic_success")
"""Figures of an evaluation that a row holds."""


def train(
    algorithm: str,
    *,
    directory: Path | str,
    seed: int | None = None,
    steps: int | None = None,
    minutes: float | None = None,
    device: str = "auto",
    resume: bool = False,
    threads: int | None = None,
    options: Iterable[str] = (),
    on_row: Callable[[Row], None] = lambda _: None,
    on_note: Callable[[str], None] = lambda _: None,
) -> Path:
    """Train an agent, and return the path of the best checkpoint.

    The directory then holds ``best.pt``, ``state.pt`` (to resume from), ``progress.csv``, ``config.json``,
    ``tensorboard/`` and what else the method leaves. A resumed run continues with its weights, optimiser, random state,
    schedule and steps, and with new drives. Ctrl-C and SIGTERM end a run after its next row: it saves, and raises
    KeyboardInterrupt.

    Args:
        algorithm: name of a method.
        directory: directory of the run; made if it is missing.
        seed: seed of weights, drives and actions; 1 by default. A resumed run keeps its own.
        steps: length in what the method counts; the settings' if neither steps nor minutes are given.
        minutes: wall clock for everything. The learning rate falls with steps or minutes, whichever is further on.
        device: ``cpu``, ``cuda`` or ``auto``.
        resume: continue the run in the directory.
        threads: threads of the simulation, and of torch on the CPU; all cores by default.
        options: ``name=value`` of the settings' fields.
        on_row: called with each row of ``progress.csv``, and its ``done``, ``unit`` and ``part``.
        on_note: called with what happens between rows.

    Raises:
        TrainingError: an argument is invalid, a file of the run is damaged or cannot be written, or memory is short.
    """
    method, folder, options = find_method(algorithm), Path(directory), tuple(options)
    settings = method.settings().with_options(options)
    if resume:
        begun = replace(Begun.read(folder, method), finished=False)
        check_resumed(options, seed, begun.seed)
        if steps is not None or minutes is not None:  # to train for longer
            begun = replace(begun, steps=steps, minutes=minutes)
    else:
        limit = settings.length if steps is None and minutes is None else steps
        begun = Begun(settings, 1 if seed is None else seed, limit, minutes)
    check_seed(begun.seed)
    check_threads(threads)
    Budget(begun.steps, begun.minutes)  # reports invalid limits before a directory is made
    place = device_of(device)
    given = None if resume else method.prepare(begun.settings)
    with memory_named(begun.settings, place), held(folder, resume=resume):
        state = read_state(folder) if resume else None
        begun.write(folder, place)
        budget = Budget(begun.steps, begun.minutes, used=state["seconds"] if state else 0.0)
        run = Run(method, begun, folder, place, prepare(place, threads), budget)
        run.given, run.state, run.on_row, run.on_note = given, state, on_row, on_note
        torch.manual_seed(run.seed)
        with run.stop.listening():
            method.learn(run)
        replace(begun, finished=True).write(folder, place)
    return folder / BEST


class Run:
    """What a method learns with: settings, device and budget, and all that it reports and saves.

    A method that learns by driving calls :meth:`begin`, then for each step of its cars :meth:`drove`, now and then
    :meth:`tick`, until :meth:`over`, and at last :meth:`finish`. The other methods call the same parts one by one.

    Attributes:
        settings: the method's settings.
        seed: the run's seed; :meth:`stream` makes others of it.
        folder: the run's directory.
        device: device to learn on.
        threads: threads of the simulation.
        budget: steps and minutes.
        given: what the method's ``prepare`` returned; None for a resumed run.
        state: what an interrupted run kept by :meth:`save_state`; None for a run that begins.
    """

    def __init__(
        self, method: Method, begun: Begun, folder: Path, device: torch.device, threads: int, budget: Budget
    ) -> None:
        self.method, self.begun, self.folder, self.device, self.threads = method, begun, folder, device, threads
        self.settings: Any = begun.settings
        self.seed, self.budget = begun.seed, budget
        self.given: Any = None
        self.state: dict[str, Any] | None = None
        self.on_row: Callable[[Row], None] = lambda _: None
        self.on_note: Callable[[str], None] = lambda _: None
        self.last: Evaluation | None = None
        self.stop = Stop()
        self.logger = Logger(str(folder), [TensorBoardOutputFormat(str(folder / "tensorboard"))])
        self._verdicts: Counter[str] = Counter()
        self._recent: deque[tuple[float, int]] = deque(maxlen=_EPISODES)
        self._row_at = self._evaluated_at = 0
        self._saved_at = self._shown_at = budget.used

    # ---- any method

    def stream(self, *numbers: int) -> int:
        """Return a seed of the run for some purpose, far from those of other runs and purposes."""
        return int(np.random.SeedSequence([self.seed, *numbers]).generate_state(1)[0]) >> 1

    def over(self, steps: int) -> bool:
        """Return whether learning must end now."""
        return self.budget.over(steps)

    def open(self, steps: int = 0, *, file: str = "progress.csv", part: str | None = None) -> None:
        """Begin to learn, after the steps of an interrupted run: the schedule begins now, and rows go to a file.

        ``part`` names this part of the run on the screen.
        """
        self._part = part
        self.budget.begun = self.state["begun"] if self.state else self.budget.used
        self.stop.armed = True
        self._rows = ProgressFile(self.folder / file, self.method.columns, resumed_at=steps if self.state else None)
        self._row_at, self._saved_at, self._shown_at = steps, self.budget.used, self.budget.used

    def row(self, steps: int, evaluation: Evaluation | None = None, **figures: Any) -> None:
        """Write a row of progress, with the method's figures by column: to the file, TensorBoard and the screen."""
        seconds = self.budget.used - self._shown_at
        ended = self._verdicts.total()
        found: Row = {
            "step": steps,
            "done": self.budget.fraction(steps),
            "minutes": self.budget.used / 60.0,
            **self._drives(),
            **{name: self._verdicts[name] / ended if ended else None for name in VERDICTS},
            "steps_per_second": (steps - self._row_at) / max(seconds, 1e-9),
        }
        if evaluation is not None:
            found |= {f"{name}_heldout": getattr(evaluation, name) for name in _FIGURES}
        self._row_at, self._shown_at = steps, self.budget.used
        self._verdicts.clear()
        self._rows.add({**found, **figures})
        for kind, values in (("run", found), ("train", figures)):
            for name, value in values.items():
                if isinstance(value, int | float):
                    self.logger.record(f"{kind}/{name}", value)
        self.logger.dump(steps)
        self.on_row({**found, **figures, "unit": self.method.unit, "part": self._part})

    def evaluate(
        self,
        agents: Sequence[AnyModel],
        *,
        last: bool = False,
        track: str | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> list[Evaluation] | None:
        """Drive held-out journeys with several agents at once: the shortest ones, or all if they are the last.

        The track of their observations is the settings' by default. ``stop`` returns whether to give up, which leaves
        None; by default when the minutes are used.
        """
        settings, begin = self.settings, time.monotonic()
        trials = self._journeys if last else self.brief
        found = Evaluation.each(
            agents,
            [*trials, *with_traffic(trials)] if settings.traffic else trials,
            track=track or settings.track,
            device=self.device,
            threads=self.threads,
            patience=settings.patience,
            strict=settings.strict_evaluation,
            stop=stop or self.budget.out_of_time,
            least=settings.brief_journeys,
            towns={town.name: town for town in self._towns},
            own_traffic=MEETING if self._towns else FleetTraffic(),
        )
        took = time.monotonic() - begin
        self._shown_at += took  # so that it does not count for the steps per second
        if self.budget.seconds is not None and not last:
            # Keep time for the last evaluation, which comes after learning.
            needed = 1.3 * longest(self._journeys) / longest(self.brief) * took
            self.budget.reserve = min(needed, 0.3 * self.budget.seconds)
        return found

    def save(
        self, file: str, agent: nn.Module, steps: int, evaluation: Any = None, *, algorithm: str | None = None,
        halved: bool = False,
    ) -> None:  # fmt: skip
        """Write a checkpoint of an agent that learned from some steps; ``best.pt`` is what the run returns.

        The evaluation is an :class:`Evaluation`, or a dict of figures. The agent is the method's first, unless
        ``algorithm`` names another. ``halved`` stores the weights in half precision.
        """
        said = asdict(evaluation) if isinstance(evaluation, Evaluation) else evaluation or {}
        name = algorithm or self.method.name
        save_checkpoint(
            self.folder / file, agent, self.settings, algorithm=name, seed=self.seed, steps=steps, evaluation=said,
            halved=halved,
        )  # fmt: skip

    def save_state(self, **state: Any) -> None:
        """Write what :attr:`state` is when the run is resumed. If someone stopped the run, it ends here."""
        self._write_state(state)
        self.stop.saved()

    def _write_state(self, state: Mapping[str, Any]) -> None:
        self._saved_at = self.budget.used
        write(self.folder / STATE, {**state, "seconds": self.budget.used, "begun": self.budget.begun})

    @property
    def save_due(self) -> bool:
        """Whether it is time to save."""
        return self.stop.asked or self.budget.used - self._saved_at > 60.0 * float(self.settings.save_every)

    @contextmanager
    def restoring(self) -> Iterator[dict[str, Any]]:
        """Give the state to continue from, and report that it does not fit if the block fails on it."""
        try:
            yield self.state or {}
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise TrainingError(
                f"resume: {STATE} is of other networks than this version's; begin anew in another directory"
            ) from error

    # ---- methods that learn by driving

    @property
    def steps(self) -> int:
        """Steps of the interrupted run; 0 for one that begins."""
        return int(self.state["steps"]) if self.state else 0

    def begin(self, agent: nn.Module, state: Callable[[], dict[str, Any]] = dict) -> None:
        """Begin to learn. ``state`` returns what the run needs to continue, beside its steps."""
        self._agent, self._state = agent, state
        self._candidates = Candidates(agent)
        if self.state is not None:
            self._evaluated_at = self.state["evaluated_at"]
            if (self.folder / BEST).is_file():
                self._candidates.restore(load_checkpoint(self.folder / BEST))
        self.open(self.steps)
        if self.state is None and (self.folder / ENCODER).is_file():  # a pretraining is not lost
            self._save_last(0, None)

    def drove(self, infos: Iterable[Mapping[str, Any]]) -> None:
        """Count the drives that ended in a step, by the infos of ``training_cars``."""
        for info in infos:
            if info:
                self._verdicts[info["verdict"]] += 1
                if "episode" in info:
                    self._recent.append((info["episode"]["r"], info["episode"]["l"]))

    def consider(self, steps: int) -> None:
        """Remember the agent as it is before an update, if none drove better since the last held-out journeys."""
        if len(self._recent) == _EPISODES:
            self._candidates.drove(self._drives()["reward_mean"], steps)

    def tick(self, steps: int, **figures: Any) -> None:
        """Write a row. Drive held-out journeys and save, if it is time for that."""
        due = steps - self._evaluated_at >= self.settings.evaluate_every
        late = self.budget.fraction(steps) >= _LATE
        self.row(steps, self._judge(steps) if due and not late else None, **figures)
        if self.save_due:
            self._save_last(steps, self.last)
            self.stop.saved()

    def finish(self, steps: int, **figures: Any) -> None:
        """Drive the last held-out journeys, choose the best agent, and save."""
        self.row(steps, self._judge(steps, last=True), **figures)

    def _judge(self, steps: int, *, last: bool = False) -> Evaluation | None:
        """Evaluate the agent and its candidates, and save them. Return the current agent's evaluation."""
        candidates, learning = self._candidates, self._agent.training
        known = candidates.best.evaluation if candidates.best else None
        again = last or (known is not None and known.journeys != len(self.brief))
        chosen = candidates.to_judge(steps, again=again)
        self._agent.eval()
        found = self.evaluate([one.model for one in chosen], last=last)
        self._agent.train(learning)
        self._evaluated_at = steps
        kept: Candidate | None = None
        if found is not None:
            best = max(range(len(chosen)), key=lambda i: found[i].rank)
            if again or known is None or found[best].rank > known.rank:
                candidates.judged(chosen[best], found[best])
                kept = candidates.best
            candidates.promising = None
            self.last = found[0]
        elif candidates.best is None:
            kept = candidates.promising or chosen[0]
        now = found[0] if found else None
        self._save_last(steps, now)
        if kept is not None:
            self.save(BEST, kept.model, kept.steps, kept.evaluation)
        return now

    def _save_last(self, steps: int, evaluation: Evaluation | None) -> None:
        """Save the agent, and what the run continues from: everything except the drives in progress.

        The state comes first. A run that is killed before its first agent is written can be resumed.
        """
        self._write_state({**self._state(), "steps": steps, "evaluated_at": self._evaluated_at})
        self.save(LAST, self._agent, steps, evaluation)

    def _drives(self) -> dict[str, float]:
        """Return means over the newest drives; nothing if there were none."""
        if not self._recent:
            return {}
        rewards, lengths = zip(*self._recent, strict=True)
        return {
            "reward_mean": float(np.mean(rewards)),
            "episode_length": float(np.mean(lengths)),
            "reward_per_decision": sum(rewards) / sum(lengths),
        }

    @cached_property
    def _towns(self) -> list[Town]:
        """Generated towns of held-out journeys, if the run learns in drawn ones."""
        return held_out_towns(self.settings)

    @cached_property
    def _journeys(self) -> list[Any]:
        return held_out_journeys(self.settings.journeys, self._towns)

    @cached_property
    def brief(self) -> list[Any]:
        """The shortest held-out journeys, which the earlier evaluations drive."""
        return shortest(self._journeys, self.settings.brief_journeys)
