"""Drives the trials of a suite over a service as practice: it shows their outcomes and never ranks them."""

import re
import threading
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Final

from rich.table import Table
from rich.text import Text

from wrongturn_agents.errors import RunError
from wrongturn_agents.progress import Progress
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.results_file import ResultsFile, TrialResult, resumed
from wrongturn_agents.suites import SuiteTrials
from wrongturn_agents.worker import GuardedAgent, episodes_side_by_side
from wrongturn_client import Client
from wrongturn_client.evaluation_driver import drive_episode
from wrongturn_client.practice import practice_token
from wrongturn_client.tables import plain_table
from wrongturn_protocol import FaultKind, PracticeRequest, Trial, Verdict
from wrongturn_protocol.json_output import write_json
from wrongturn_protocol.words import name

_DONE: Final = {Verdict.EXIT_COMMANDED, Verdict.ARRIVED}


class PracticeRun:
    """Drives those of a suite's trials that a results file lacks, twins included, and writes the file after each.

    Of a suite that draws its trials, these are the open draw's. With a task, such as ``navigation_dynamic``, only its
    trials are driven. The file is one that ``wrongturn results`` reads; None writes none.

    Raises:
        RunError: The suite has no such task, or the file belongs to another run.
        ResultsError: The file exists and is not a results file.
    """

    def __init__(self, source: AgentSource, suite: SuiteTrials, task: str | None, file: Path | None) -> None:
        self.trials = trials_of(suite, task)
        self._source, self._suite, self._file = source, suite, file
        run = ResultsFile(
            agent=name_in_file(source),
            suite=suite.id,
            suite_sha256=suite.sha256,
            secret=suite.secret,
            driven="over the service",
            trials={},
        )
        (self._results,) = resumed([run], file)
        if not self._results.trials.keys() <= set(self.trials):
            raise RunError(f"--json: {file} has trials of another task; name a new file")
        self._lock, self._stop = threading.Lock(), threading.Event()

    def drive(self, url: str, token: str | None, progress: Progress, *, parallel: int | None = None) -> ResultsFile:
        """Drive the missing trials and return all results.

        Without a token, an agent is registered for practice. ``progress`` is called with the numbers of finished and of
        all trials; ``parallel`` is as in :func:`~wrongturn_agents.worker.episodes_side_by_side`.

        Raises:
            RunError: The service has another version of the suite.
            JsonFileError: The file cannot be written.
            AgentFailedError: The agent failed. The file holds the results so far.
            WrongturnError: The service refuses, or cannot be reached any more. The file holds the results so far.
        """
        agent = self._source.make()
        with Client(url, token or "") as client:
            if client.suite(self._suite.id).sha256 != self._suite.sha256:
                raise RunError(
                    f"--url: the service has another {self._suite.id} than is installed here; install its version"
                )
            if token is None:
                token = practice_token(client, self._source.track, self._source.rig)
        progress(len(self._results.trials), len(self.trials))
        self._write()
        guarded = GuardedAgent(self._source.name, agent)
        missing = [trial for trial in self.trials if trial not in self._results.trials]
        with ThreadPoolExecutor(episodes_side_by_side(agent, parallel)) as threads:
            jobs = [threads.submit(self._drive_trial, trial, guarded, url, token, progress) for trial in missing]
            try:
                done, _ = wait(jobs, return_when=FIRST_EXCEPTION)
            finally:  # after Ctrl-C too
                self._stop.set()
        for job in done:
            job.result()
        return self._results

    def _drive_trial(self, trial: str, agent: GuardedAgent, url: str, token: str, progress: Progress) -> None:
        """Drive one trial and write its result, unless the run is stopping."""
        if self._stop.is_set():
            return
        with Client(url, token) as client:
            begun = client.practise(PracticeRequest(suite=self._suite.id, trial=trial, track=self._source.track))
            drive_episode(client, agent, begun, stop=self._stop)
            ended = client.episode(begun.id)
        if ended.outcome is None:
            raise RunError(f"--practice: the service does not show how {trial} ended; leave --practice out")
        with self._lock:
            trials = {**self._results.trials, trial: TrialResult.of(ended.outcome, ended.trajectory_sha256)}
            self._results = self._results.model_copy(update={"trials": trials})
            self._write()
            progress(len(trials), len(self.trials))

    def _write(self) -> None:
        write_json(self._results.text(), self._file)


def name_in_file(source: AgentSource) -> str:
    """Return an agent's name as a results file has it."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", source.name)


def trials_of(suite: SuiteTrials, task: str | None) -> tuple[str, ...]:
    """Return the ids of a suite's trials, or of a task's. Raises RunError if the suite has no such task."""
    if task is None:
        return tuple(suite.trials)
    journeys = {trial.id: trial.journey for trial in suite.trials.values() if trial.journey is not None}
    trials = tuple(trial for trial, journey in journeys.items() if journey.task == task)
    if not trials:
        known = sorted({journey.task for journey in journeys.values()})
        raise RunError(f"--task: {suite.id} has no task {task!r}; it has {', '.join(known) or 'none'}")
    return trials


def practice_table(results: ResultsFile, suite: SuiteTrials) -> Table:
    """Return a row for each fault and junction type, or for each task of journeys, and the totals.

    Trials with a fault count as unsafe as in the strict column. Twins and journeys count as done.
    """
    kinds: dict[tuple[bool, str, str], list[TrialResult]] = {}
    for trial, result in results.trials.items():
        kinds.setdefault(_kind(suite.trials[trial]), []).append(result)
    table = plain_table(f"{results.agent} on {results.suite}: practice")
    for number, head in enumerate(("fault", "of", "unsafe", "done")):
        table.add_column(head, no_wrap=True, justify="left" if number < 2 else "right")
    table.add_column("how they ended")
    for (faultless, fault, of), found in sorted(kinds.items()):
        counts = ("–", _done(found)) if faultless else (_unsafe(found), "–")
        endings = Counter(name(one.verdict) for one in found).most_common()
        table.add_row(*map(Text, (fault, of, *counts, ", ".join(f"{ending} {count}" for ending, count in endings))))
    faulty = [one for (faultless, *_), found in kinds.items() if not faultless for one in found]
    others = [one for (faultless, *_), found in kinds.items() if faultless for one in found]
    totals = [f"{_unsafe(faulty)} trials unsafe (strict)"] * bool(faulty)
    totals += [f"{_done(others)} {'twins' if faulty else 'journeys'} done"] * bool(others)
    draw = "the suite's own trials" if suite.secret is None else "the open draw, which everybody knows"
    table.caption = Text(f"{'; '.join(totals)}\nPractice on {draw}. It is never scored.")
    return table


def _kind(trial: Trial) -> tuple[bool, str, str]:
    """Return what trials of one row share, in the order of rows: whether they have no fault, the fault, and where."""
    if trial.journey is not None:
        return True, "journey", name(trial.journey.task)
    faultless = trial.fault.kind is FaultKind.NONE
    return faultless, "no fault (twin)" if faultless else name(trial.fault.kind), name(trial.junction_type)


def _unsafe(found: Sequence[TrialResult]) -> str:
    return f"{sum(one.unsafe_strict for one in found)}/{len(found)}"


def _done(found: Sequence[TrialResult]) -> str:
    return f"{sum(one.verdict in _DONE for one in found)}/{len(found)}"
