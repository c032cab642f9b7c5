"""An agent's drives of a suite's trials, from a run file, a service, or the stored results: what figures show."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import ResultsFile, TrialResult, read_runs
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS
from wrongturn_agents.stored_results import STORED, shipped_results
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite, sha256_of_suite
from wrongturn_client import AuthenticationError, Client, NotFoundError
from wrongturn_protocol import DrivenEpisode, Outcome, RunFile, RunFormatError, Trial
from wrongturn_protocol.episodes import twin_id
from wrongturn_protocol.run_file import UNREADABLE, read_unpacked
from wrongturn_protocol.standing_rows import TRAINED

_NAMED: Final = 12  # agents that an error names as examples


@dataclass(frozen=True)
class Drive:
    """One trial, and how it was driven."""

    trial: Trial
    result: TrialResult
    """Verdict, reaction and flags."""
    outcome: Outcome | None = None
    """All figures of the outcome; None in stored results, which keep no more than ``result``."""
    episode: str | None = None
    """Id of the episode; None in stored results."""
    path: tuple[tuple[float, float], ...] = ()
    """Positions of the body's centre, town frame, metres; empty if they are not known."""


@dataclass(frozen=True)
class EvaluationRecord:
    """All drives of one agent on one suite."""

    agent: str
    """The name that figures show."""
    suite: str
    suite_sha256: str
    secret: str | None
    """Secret of the draw; None for a suite that lists its trials."""
    by_trial: Mapping[str, Drive]
    """Trials and twins by id, in the suite's order."""
    run: RunFile | None = None
    """The finished evaluation, without trajectories; None in stored results."""
    seed: int | None = None
    """Training seed, where it is known."""
    trained_on_faults: bool = False
    """Whether the agent met wrong commands in its training."""

    @property
    def label(self) -> str:
        """The name that figures show, marked if the agent met wrong commands in its training."""
        return f"{self.agent} {TRAINED}" if self.trained_on_faults else self.agent

    @property
    def trials(self) -> tuple[Drive, ...]:
        """The drives that count: all but the twins."""
        return tuple(drive for drive in self.by_trial.values() if not drive.trial.is_twin)

    @property
    def twins(self) -> tuple[Drive, ...]:
        """The twins."""
        return tuple(drive for drive in self.by_trial.values() if drive.trial.is_twin)

    def twin(self, drive: Drive) -> Drive | None:
        """Return the twin of a trial; None for a trial that has none, such as a journey."""
        return None if drive.trial.is_twin else self.by_trial.get(twin_id(drive.trial))

    def pairs(self) -> Iterator[tuple[Drive, Drive]]:
        """Yield each trial with its twin.

        Raises:
            ResultsError: The suite has no twins.
        """
        found = [(drive, twin) for drive in self.trials if (twin := self.twin(drive)) is not None]
        if not found:
            raise ResultsError(
                f"{self.agent}: {self.suite} has no twins to compare with; choose a run of {WRONG_COMMAND}"
            )
        yield from found

    def named(self, agent: str) -> "EvaluationRecord":
        """Return the same drives under another name."""
        return replace(self, agent=agent)


def of_run(run: RunFile) -> EvaluationRecord:
    """Return the drives in a run file.

    Raises:
        ResultsError: The run is of another version of its suite than the one installed, or trials are missing.
    """
    check_suite(run.suite, run.suite_sha256)
    trials, driven = installed_suite(run.suite, run.secret).trials, run.by_trial()
    if driven.keys() != trials.keys():
        lacking, unknown = sorted(trials.keys() - driven), sorted(driven.keys() - trials)
        what = f"lacks {lacking[0]}" if lacking else f"has {unknown[0]}, which the draw of its secret does not have"
        raise ResultsError(
            f"{run.driver.name}: episodes: the run {what}; write it again with "
            f"'wrongturn run --resume {run.id} --json FILE'"
        )
    found = {name: _drive(trial, driven[name]) for name, trial in trials.items()}
    bare = tuple(one.model_copy(update={"trajectory": None}) for one in run.episodes)
    kept = run.model_copy(update={"episodes": bare})
    return EvaluationRecord(
        run.driver.name,
        run.suite,
        run.suite_sha256,
        run.secret,
        found,
        kept,
        trained_on_faults=run.driver.trained_on_faults,
    )


def check_suite(suite: str, driven: str) -> None:
    """Raise ResultsError if a run was driven on another version of a suite than the one installed."""
    installed = sha256_of_suite(suite)
    if driven != installed:
        raise ResultsError(
            f"suite_sha256: the run is of another {suite} ({driven[:12]}) than the one installed ({installed[:12]}); "
            "install that version, or drive it again on this one"
        )


def of_results(file: ResultsFile) -> EvaluationRecord:
    """Return the drives in a results file, which have neither paths nor figures of the outcome."""
    trials = file.drawn.trials
    found = {name: Drive(trial, file.trials[name]) for name, trial in trials.items() if name in file.trials}
    return EvaluationRecord(
        file.agent,
        file.suite,
        file.suite_sha256,
        file.secret,
        found,
        seed=file.seed,
        trained_on_faults=file.agent in DOUBTING_AGENTS,
    )


def read(path: str | Path) -> EvaluationRecord:
    """Read a file of ``wrongturn run --json`` or ``wrongturn score --json`` with one agent, plain or compressed.

    The draws of a file with several are counted together; see :func:`pooled`.

    Raises:
        ResultsError: It is neither, has several agents, or does not fit the installed suite. The error says why.
    """
    found = pooled(read_runs_of(path))
    if len(found) != 1:
        names = ", ".join(one.agent for one in found)
        raise ResultsError(f"{path}: has runs of several agents ({names}); read them by read_runs_of")
    return found[0]


def read_runs_of(path: str | Path) -> list[EvaluationRecord]:
    """Read a file as :func:`read`, but return each run of each agent and draw. Raises ResultsError."""
    path = Path(path)
    try:
        return [of_run(RunFile.read(path))]
    except RunFormatError as error:
        if not _is_scored(path):
            raise ResultsError(str(error)) from error
    files = read_runs(path)
    for file in files:
        file.check(path.name)
    return [of_results(file) for file in files]


def pooled(runs: Iterable[EvaluationRecord]) -> list[EvaluationRecord]:
    """Return one record for each agent, with its drives in all draws; with several, the secret is None."""
    found: dict[str, EvaluationRecord] = {}
    for run in runs:
        before = found.get(run.agent)
        found[run.agent] = (
            run if before is None else replace(before, by_trial={**before.by_trial, **run.by_trial}, secret=None)
        )
    return list(found.values())


def _is_scored(path: Path) -> bool:
    """Return whether a file is one of ``wrongturn score``, perhaps damaged."""
    try:
        found = json.loads(read_unpacked(path))
    except (*UNREADABLE, ValueError, RecursionError):
        return False
    first = found[0] if isinstance(found, list) and found else found
    return isinstance(first, dict) and {"agent", "driven"} <= first.keys()


def stored(agent: str, suite: str = WRONG_COMMAND, directory: Path = STORED) -> EvaluationRecord:
    """Return the stored results of a shipped agent: verdicts, without paths.

    Raises:
        ResultsError: There are none. The error names the agents that have some.
    """
    found = shipped_results(suite, directory)
    if agent not in found:
        raise ResultsError(
            f"{agent}: no such run file, and no stored results on {suite}; give a file of 'wrongturn run --json', or "
            f"one of {', '.join(found)}; for an agent of a service, give --url too"
        )
    return of_results(found[agent])


def fetch(url: str, wanted: str, suite: str = WRONG_COMMAND) -> EvaluationRecord:
    """Return a finished evaluation's drives from a service.

    ``wanted`` is the name or id of an agent with an entry on the suite's leaderboard, or the id of an evaluation.

    Raises:
        ResultsError: The service has no such agent or evaluation, or it is not finished.
        WrongturnError: The service cannot be reached.
    """
    with Client(url, "", patience=0) as client:
        entries = [entry for entry in client.leaderboard(suite).entries if entry.evaluation is not None]
        ids = {entry.agent.name: entry.evaluation for entry in entries}
        ids |= {entry.agent.id: entry.evaluation for entry in entries}
        try:
            return of_run(client.run_file(ids.get(wanted) or wanted))
        except (NotFoundError, AuthenticationError) as error:  # one that is unknown, or not finished yet
            names = sorted(entry.agent.name for entry in entries)
            some = ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")
            raise ResultsError(
                f"{wanted}: {url} has no agent of this name with results on {suite}, and no such finished evaluation; "
                f"agents with results there: {some or 'none'}"
            ) from error


def checked(runs: Sequence[EvaluationRecord]) -> Sequence[EvaluationRecord]:
    """Return the runs, if there are some, all of one suite and each of another agent.

    Raises:
        ResultsError: They are not.
    """
    if not runs:
        raise ResultsError("runs: there is none; give one or more")
    suites = sorted({run.suite for run in runs})
    if len(suites) > 1:
        raise ResultsError(f"runs: they are on {' and '.join(suites)}; one figure or table shows one suite")
    names = [run.agent for run in runs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ResultsError(f"runs: two are of {twice!r}; give one another name by NAME=RUN, or .named() in Python")
    return runs


def _drive(trial: Trial, episode: DrivenEpisode) -> Drive:
    result = TrialResult.of(episode.outcome)
    return Drive(trial, result, episode.outcome, episode.id, _path(episode))


def _path(episode: DrivenEpisode) -> tuple[tuple[float, float], ...]:
    """Return the positions of a trajectory.

    Raises:
        ResultsError: It has no equally long lists of numbers ``x`` and ``y``.
    """
    if episode.trajectory is None:
        return ()
    try:
        return tuple(
            (float(x), float(y)) for x, y in zip(episode.trajectory["x"], episode.trajectory["y"], strict=True)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(
            f"episode {episode.id}: trajectory: its columns x and y are no equally long lists of numbers; "
            "write the run file again"
        ) from error
