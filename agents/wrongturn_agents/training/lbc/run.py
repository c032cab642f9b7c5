"""``wrongturn train lbc``: both halves of "Learning by Cheating", one after the other, in a run's directory."""

import dataclasses
import hashlib
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from wrongturn_agents.models.lbc import PrivilegedAgent, SensorimotorAgent, WaypointAgent
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.checkpoint import read, versions, write
from wrongturn_agents.training.devices import check_threads, device_of, prepare
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.held_out import Evaluation, held_out_journeys, longest, shortest, with_traffic
from wrongturn_agents.training.lbc.checkpoints import BEST, PRIVILEGED_FILE, load_agent, save_agent
from wrongturn_agents.training.lbc.config import ALGORITHM, PRIVILEGED, LBCConfig
from wrongturn_agents.training.lbc.learning import Learner
from wrongturn_agents.training.lbc.privileged import learn_privileged
from wrongturn_agents.training.lbc.rows import COLUMNS, shares
from wrongturn_agents.training.lbc.sensorimotor import Teacher, learn_sensorimotor, round_of
from wrongturn_agents.training.memory import memory_of
from wrongturn_agents.training.progress_file import ProgressFile
from wrongturn_agents.training.run_directory import CONFIG, STATE, check_resumed, held, read_config, read_state
from wrongturn_protocol import Track

_ROWS: Final = 100
"""Rows of a half."""
_SEEDS: Final = 2**31
_PICTURE: Final = 64 * 192 * 3
_MARGIN: Final = 1.3
_MOST_RESERVED: Final = 0.2
"""Greatest share of the minutes for the last evaluation. The evaluations before it tell how long it takes. The
privileged agent's evaluation gets at most this share too."""
_KEYS: Final = {"half", "learner", "seconds", "begun"}
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Run:
    """What a run is: its settings, seed and limits."""

    config: LBCConfig
    seed: int
    samples: int | None
    minutes: float | None
    teacher: str | None = None
    """SHA-256 of the privileged agent's file, if one was given and none is trained."""

    def write(self, folder: Path) -> None:
        """Write ``config.json``."""
        content = {
            "algorithm": ALGORITHM,
            "variant": self.config.variant,
            "seed": self.seed,
            "steps": self.samples,
            "minutes": self.minutes,
            "teacher": self.teacher,
            "config": self.config.as_dict(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
            "versions": versions(),
        }
        (folder / CONFIG).write_text(json.dumps(content, indent=1) + "\n", "utf-8")

    @classmethod
    def read(cls, folder: Path) -> "Run":
        """Read ``config.json``.

        Raises:
            OtherRunError: the run is of another algorithm.
            TrainingError: the folder holds no run, or the file is damaged.
        """
        return read_config(
            folder,
            {ALGORITHM},
            lambda content: cls(
                LBCConfig.of(content["config"]),
                content["seed"],
                content["steps"],
                content["minutes"],
                content.get("teacher"),
            ),
        )


def train(
    *,
    directory: Path,
    seed: int | None = None,
    samples: int | None = None,
    minutes: float | None = None,
    device: str = "auto",
    threads: int | None = None,
    resume: bool = False,
    teacher: Path | None = None,
    options: Sequence[str] = (),
    on_row: Callable[[str, Row], None] = lambda _half, _row: None,
) -> Path:
    """Train the privileged agent and then the one with a camera, and return the latter's checkpoint.

    Args:
        directory: the run's directory. It gets ``privileged.pt``, ``best.pt``, ``privileged.csv``, ``progress.csv``,
            ``config.json`` and ``state.pt``.
        seed: seed of weights and drives; 1 by default.
        samples: samples for the agent with a camera; by default those of the settings, or no limit with ``minutes``.
        minutes: wall clock for everything. The privileged agent gets ``privileged_share`` of it.
        device: ``cpu``, ``cuda`` or ``auto``.
        threads: threads of simulation and torch; all cores by default.
        resume: continue the run in the directory, with its own settings. Samples are collected anew.
        teacher: a privileged agent's checkpoint. The agent with a camera learns from it, and gets all samples and
            minutes. The run's directory gets a copy.
        options: settings as ``name=value``; see :class:`LBCConfig`.
        on_row: called with the half and each row.

    Raises:
        TrainingError: an argument is wrong, the teacher is no privileged agent, or the directory has a run or none to
            resume.
    """
    place = device_of(device)
    config = LBCConfig().with_options(options)
    if resume and teacher is not None:
        raise TrainingError("teacher: the run has its own; leave --teacher out with --resume")
    given = None if teacher is None else _privileged(teacher)
    if resume:
        run = _resumed(Run.read(directory), seed, samples, minutes, options)
    else:
        limit = config.samples if samples is None and minutes is None else samples
        digest = None if given is None else hashlib.sha256(given).hexdigest()
        run = Run(config, 1 if seed is None else seed, limit, minutes, digest)
    if not 0 <= run.seed < _SEEDS:
        raise TrainingError(f"seed: is {run.seed}; give a whole number from 0 to {_SEEDS - 1}")
    check_threads(threads)
    Budget(run.samples, run.minutes)  # reports wrong limits before a directory is made
    _check_memory(run.config, place)
    with held(directory, resume=resume):
        state = read_state(directory, _KEYS) if resume else None
        run.write(directory)
        if given is not None:
            (directory / PRIVILEGED_FILE).write_bytes(given)
        return _Training(run, directory, place, prepare(place, threads), on_row).train(state)


class _Training:
    """One run, from its beginning or from a state."""

    def __init__(
        self, run: Run, folder: Path, device: torch.device, threads: int, on_row: Callable[[str, Row], None]
    ) -> None:
        self.run, self.folder, self.device, self.threads, self.on_row = run, folder, device, threads, on_row

    def train(self, state: dict[str, Any] | None) -> Path:
        """Train both agents, or the one with a camera alone, and return that one's checkpoint."""
        config, seed = self.run.config, self.run.seed
        torch.manual_seed(seed)
        privileged = self._on_device(PrivilegedAgent(config.width))
        student = self._on_device(SensorimotorAgent(config.width))
        used = state["seconds"] if state else 0.0
        if self.run.teacher is None and (state is None or state["half"] == PRIVILEGED):
            self._first(Learner(privileged, config), state, used)
            used, state = self._clock.used, None
        teacher, _ = load_agent(self.folder / PRIVILEGED_FILE, self.device)
        self._second(Learner(student, config), self._on_device(teacher.requires_grad_(False)), state, used)
        return self.folder / BEST

    def _first(self, learner: Learner, state: dict[str, Any] | None, used: float) -> None:
        config, run = self.run.config, self.run
        minutes = None if run.minutes is None else run.minutes * config.privileged_share
        samples = config.privileged_samples if run.minutes is None or run.samples is not None else None
        self._half(PRIVILEGED, learner, state, Budget(samples, minutes, used=used))
        self._clock.reserve = 0.0  # its evaluation is a short one, and the other half has time left
        learn_privileged(
            learner, config, seed=_stream(run.seed, 0, learner.seen), budget=self._clock, threads=self.threads,
            on_update=self._update,
        )  # fmt: skip
        # The half's own minutes are used up by now. Its evaluation takes some of the other half's.
        end = None if run.minutes is None else run.minutes * min(1.0, config.privileged_share + _MOST_RESERVED)
        evaluation = self._drive("privileged", last=False, clock=Budget(samples, end, used=self._clock.used))
        self._row(evaluation)
        self._save_agent(PRIVILEGED_FILE, evaluation)

    def _second(self, learner: Learner, teacher: WaypointAgent, state: dict[str, Any] | None, used: float) -> None:
        config, run = self.run.config, self.run
        self._half(ALGORITHM, learner, state, Budget(run.samples, run.minutes, used=used))
        learn_sensorimotor(
            learner, Teacher(teacher, white_box=config.white_box), config, seed=_stream(run.seed, 1, learner.seen),
            budget=self._clock, threads=self.threads, on_update=self._update,
        )  # fmt: skip
        learned = self._loss is not None
        if learned:  # an interrupted evaluation is driven again on --resume
            self._save_agent(BEST, None)
            self._save_state()
        evaluation = self._drive("camera", last=True)
        self._row(evaluation)
        if learned or evaluation is not None:  # a finished run that is resumed without time left keeps what it has
            self._save_agent(BEST, evaluation)
        self._save_state()

    def _half(self, name: str, learner: Learner, state: dict[str, Any] | None, clock: Budget) -> None:
        """Begin or continue a half of the run."""
        if state is not None:
            learner.restore(state["learner"])
        self._name, self._learner, self._clock = name, learner, clock
        clock.begun = state["begun"] if state else clock.used
        file = "privileged.csv" if name == PRIVILEGED else "progress.csv"
        self._rows = ProgressFile(self.folder / file, COLUMNS, resumed_at=learner.seen if state else None)
        share = clock.fraction(learner.seen)
        self._shown, self._evaluated, self._saved = share, share, time.monotonic()
        self._told_at = time.monotonic(), learner.seen
        self._loss: Tensor | None = None
        self._collected, self._verdicts = 0, [""]

    def _update(self, loss: Tensor, collected: int, verdicts: list[str]) -> bool:
        """Note an update; write a row, evaluate and save when it is time. Return whether to go on."""
        self._loss, self._collected, self._verdicts = loss.detach(), collected, verdicts
        config = self.run.config
        share = self._clock.fraction(self._learner.seen)
        evaluation = None
        if self._name == ALGORITHM and share < 1.0 and share - self._evaluated >= 1.0 / config.evaluations:
            self._evaluated = share
            evaluation = self._drive("camera", last=False)
        if evaluation is not None or share - self._shown >= 1.0 / _ROWS:
            self._shown = share
            self._row(evaluation)
        if evaluation is not None or time.monotonic() - self._saved > 60.0 * config.save_every:
            self._saved = time.monotonic()
            self._save_state()
            if self._name == ALGORITHM:
                self._save_agent(BEST, evaluation)
        return not self._clock.out_of_time()

    def _drive(self, track: str, *, last: bool, clock: Budget | None = None) -> Evaluation | None:
        """Evaluate the average of the weights on held-out journeys; None if the time is over, by default the half's."""
        config = self.run.config
        whole = held_out_journeys(config.journeys)
        journeys = whole if last else shortest(whole, config.brief_journeys)
        begin = self._clock.used
        found = Evaluation.each(
            [self._learner.average],
            [*journeys, *with_traffic(journeys)] if config.traffic else journeys,
            track=Track(track),
            device=self.device,
            threads=self.threads,
            patience=config.patience,
            strict=True,
            stop=(clock or self._clock).out_of_time,
            least=config.brief_journeys,
        )
        if self._clock.seconds is not None and not last:
            wanted = _MARGIN * (self._clock.used - begin) * longest(whole) / longest(journeys)
            self._clock.reserve = min(max(self._clock.reserve, wanted), _MOST_RESERVED * self._clock.seconds)
        return found[0] if found else None

    def _row(self, evaluation: Evaluation | None) -> None:
        """Write a row, if anything has been learned since the half was begun or resumed."""
        if self._loss is None:
            return
        begin, seen = self._told_at
        self._told_at = time.monotonic(), self._learner.seen
        share = self._clock.fraction(self._learner.seen)
        row: Row = {
            "step": self._learner.seen,
            "minutes": self._clock.used / 60.0,
            "loss": float(self._loss),
            "collected": self._collected,
            "round": round_of(share, self.run.config) if self._name == ALGORITHM else None,
            **shares(self._verdicts),
            "steps_per_second": (self._learner.seen - seen) / max(time.monotonic() - begin, 1e-9),
            "learning_rate": self._learner.rate,
            "done": share,
        }
        if evaluation is not None:
            row |= {
                "success_heldout": evaluation.success,
                "clean_heldout": evaluation.clean,
                "reward_heldout": evaluation.reward,
                "traffic_success_heldout": evaluation.traffic_success,
            }
        self._verdicts.clear()
        self._rows.add(row)
        self.on_row(self._name, row)

    def _save_agent(self, file: str, evaluation: Evaluation | None) -> None:
        save_agent(
            self.folder / file,
            self._name,
            self._learner.average,
            self.run.config,
            seed=self.run.seed,
            steps=self._learner.seen,
            evaluation={} if evaluation is None else dataclasses.asdict(evaluation),
        )

    def _save_state(self) -> None:
        learner = self._learner.state()
        write(
            self.folder / STATE,
            {"half": self._name, "learner": learner, "seconds": self._clock.used, "begun": self._clock.begun},
        )

    def _on_device(self, agent: Any) -> Any:
        return agent.to(self.device, memory_format=torch.channels_last)


def _privileged(file: Path) -> bytes:
    """Return the file of a privileged agent.

    Raises:
        TrainingError: it is missing, damaged or of another agent.
    """
    wanted = "the privileged.pt of a run of lbc"
    found = read(file, "teacher", wanted)
    algorithm = found.get("algorithm") if isinstance(found, dict) else None
    if algorithm != PRIVILEGED:
        raise TrainingError(f"teacher {file}: is {f'of {algorithm}' if algorithm else 'no agent'}; name {wanted}")
    load_agent(file)  # checks the rest
    return file.read_bytes()


def _check_memory(config: LBCConfig, device: torch.device) -> None:
    """Check that the kept samples' pictures fit into the memory.

    Raises:
        TrainingError: they do not.
    """
    wanted = config.buffer * _PICTURE
    there = memory_of(device)
    if wanted > there:
        raise TrainingError(
            f"option buffer: {config.buffer} samples need {wanted / 2**30:,.1f} GiB of pictures, and there are "
            f"{there / 2**30:,.1f}; give fewer"
        )


def _stream(seed: int, half: int, seen: int) -> int:
    """Return a seed of drives, far from those of other runs and of the other half."""
    return int(np.random.SeedSequence([seed, half, seen]).generate_state(1)[0])


def _resumed(run: Run, seed: int | None, samples: int | None, minutes: float | None, options: Sequence[str]) -> Run:
    """Return what a resumed run continues with. Samples and minutes may be given again, to train for longer."""
    check_resumed(options, seed, run.seed)
    if samples is None and minutes is None:
        return run
    return dataclasses.replace(run, samples=samples, minutes=minutes)
