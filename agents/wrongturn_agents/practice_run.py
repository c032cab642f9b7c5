"""The trials of one task of a suite, driven over a service in practice: shown, never ranked."""

import re
import secrets
import threading
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path

from wrongturn_agents.errors import RunError
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.reporting.results_file import ResultsFile, TrialResult
from wrongturn_agents.suites import SuiteTrials
from wrongturn_agents.worker import GuardedAgent, Progress, side_by_side
from wrongturn_client import Client
from wrongturn_client.evaluation_driver import drive_episode
from wrongturn_protocol import PracticeRequest, Trial


class PracticeRun:
    """Drives what a file lacks of a task's trials, and writes the file after each: it can be gone on with.

    Args:
        source: the agent.
        suite: whose trials.
        task: of these, such as ``navigation_dynamic``.
        file: where what each came to is kept, as ``wrongturn results --import`` takes it.

    Raises:
        RunError: the suite has no such task, or the file is of something else or cannot be written.
        ResultsError: there is such a file, and it is no results file.
    """

    def __init__(self, source: AgentSource, suite: SuiteTrials, task: str, file: Path) -> None:
        of_task = {name: _task(trial) for name, trial in suite.trials.items()}
        self.trials = tuple(name for name, of in of_task.items() if of == task)
        if not self.trials:
            known = sorted({of for of in of_task.values() if of is not None})
            raise RunError(f"--task: {suite.id} has no task {task!r}; it has {', '.join(known) or 'none'}")
        self._source, self._suite, self._file = source, suite, file
        self._results = ResultsFile(
            agent=re.sub(r"[^A-Za-z0-9._-]+", "-", source.name),
            suite=suite.id,
            suite_sha256=suite.sha256,
            driven="over the service",
            trials={},
        )
        if file.exists():
            found = ResultsFile.read(file)
            ours = self._results.model_copy(update={"trials": found.trials})
            if found != ours or not found.trials.keys() <= set(self.trials):
                raise RunError(f"--json: {file} is of another run; name another file, or the one to go on with")
            self._results = found
        self._lock, self._stop = threading.Lock(), threading.Event()

    def drive(self, url: str, token: str | None, progress: Progress, *, parallel: int | None = None) -> ResultsFile:
        """Drive what is lacking; gives all results.

        Args:
            url: of the service.
            token: of an agent that is registered there; without it one is registered for practice.
            progress: told of the trials that are done.
            parallel: episodes at a time, as :func:`~wrongturn_agents.worker.side_by_side`.

        Raises:
            RunError: the service has another version of the suite, or the file cannot be written.
            AgentFailedError: the agent raised something; what was driven before is in the file.
            WrongturnError: the service refuses, or cannot be reached any more; likewise.
        """
        agent = self._source.make()
        policy = GuardedAgent(self._source.name, agent)
        with Client(url, token) as client:
            if client.suite(self._suite.id).sha256 != self._suite.sha256:
                raise RunError(f"--url: it drives another {self._suite.id} than the one installed; install its version")
            if token is None:
                name = f"practice-{secrets.token_hex(6)}"
                token = client.register(name, self._source.track, description="Registered for practice.").token
        progress(len(self._results.trials), len(self.trials))
        self._write()

        def one(trial: str) -> None:
            if self._stop.is_set():
                return
            with Client(url, token) as client:
                request = PracticeRequest(suite=self._suite.id, trial=trial, track=self._source.track)
                begun = client.practise(request)
                drive_episode(client, policy, begun, stop=self._stop)
                outcome = client.episode(begun.id).outcome
            if outcome is None:
                raise RunError(f"--task: the service does not show how {trial} ended; drive the whole suite instead")
            result = TrialResult.of(outcome)
            with self._lock:
                trials = {**self._results.trials, trial: result}
                self._results = self._results.model_copy(update={"trials": trials})
                self._write()
                progress(len(trials), len(self.trials))

        lacking = [trial for trial in self.trials if trial not in self._results.trials]
        with ThreadPoolExecutor(side_by_side(agent, parallel)) as threads:
            jobs = [threads.submit(one, trial) for trial in lacking]
            try:
                done, _ = wait(jobs, return_when=FIRST_EXCEPTION)
            finally:  # Ctrl-C too
                self._stop.set()
        for job in done:
            job.result()
        return self._results

    def _write(self) -> None:
        beside = self._file.with_name(f".{self._file.name}.new")
        try:
            beside.write_text(self._results.text(), encoding="utf-8")
            beside.replace(self._file)
        except OSError as error:
            raise RunError(f"--json: {self._file} cannot be written ({error.strerror}); name another file") from error


def _task(trial: Trial) -> str | None:
    return None if trial.journey is None else str(trial.journey.task)
