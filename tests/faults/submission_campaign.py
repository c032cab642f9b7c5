"""Submissions that are carried to their end while the service, its runners and their sandboxes are killed."""

import os
import random
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from databases import File
from ledger import results
from processes import Service, until
from reference_drive import reference
from small_models import steady, wavering

from wrongturn_client import Client
from wrongturn_protocol import SubmissionDetail, SubmissionState

SUITE = "smoke@3"
MODELS = {"steady": steady(0.02), "wavering": wavering()}
"""One that remembers nothing, and one whose way depends on all the steps before."""
PATIENCE_S = 120.0
SERVICE, RUNNER, SANDBOX = "service", "runner", "sandbox"
VICTIMS = (SERVICE, RUNNER, SANDBOX)
CHECK, DRIVE, ANY = "check", "drive", "any"
"""What goes on at a kill. Any: whatever does, soon after the kill before."""
_PHASES = {CHECK: 2, DRIVE: 5, ANY: 2}
_PAUSE_S = 1.0
_HURT = 3
"""Runners lost in a row. After five the service rightly says that it could not drive a submission."""
_WORK_S, _END_S = 60.0, 240.0


@dataclass(frozen=True)
class Blow:
    """One kill.

    Attributes:
        victim: what is killed.
        phase: what goes on at that time.
        pause_s: seconds since it goes on.
        at_write: whether it waits for the next write to the database after the pause.
        pick: which of several such processes, from 0 to 1.
    """

    victim: str
    phase: str
    pause_s: float
    at_write: bool
    pick: float


def blows(seed: int, count: int) -> list[Blow]:
    """Draw kills. Each kind of victim is among the first three."""
    chance = random.Random(seed)
    victims = chance.sample(VICTIMS, len(VICTIMS)) + chance.choices(VICTIMS, k=max(0, count - len(VICTIMS)))
    phases = chance.choices(list(_PHASES), list(_PHASES.values()), k=count)
    return [
        Blow(victim, phase, chance.uniform(0.0, _PAUSE_S), chance.random() < 0.3, chance.random())
        for victim, phase in zip(victims, phases, strict=False)
    ]


@dataclass
class Report:
    """What a campaign came to."""

    kills: Counter[str] = field(default_factory=Counter)
    during: Counter[str] = field(default_factory=Counter)
    """States of submissions at the time of a kill."""
    lost: int = 0
    """Episodes that were given up and driven again."""
    submissions: list[SubmissionDetail] = field(default_factory=list)
    """Each at its end."""
    bad: list[str] = field(default_factory=list)
    """Whatever must not be."""


class Owner:
    """Hands in one model after the other until it is told that this one is the last."""

    def __init__(self, service: Service, folder: Path, name: str) -> None:
        self.done: list[SubmissionDetail] = []
        self.last = threading.Event()
        self.error: BaseException | None = None
        self._url = service.url
        self._name = name
        self._file = folder / f"{name}.onnx"
        self._file.write_bytes(MODELS[name])
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)

    def _run(self) -> None:
        try:
            with Client(self._url, patience=PATIENCE_S) as client:
                client.ready()
                token = client.register_owner(self._name).token
            with Client(self._url, token, patience=PATIENCE_S) as client:
                client.live()
                while not self.last.is_set():
                    self.done.append(self._hand_in(client, f"{self._name} {len(self.done) + 1}"))
        except BaseException as error:
            self.error = error

    def _hand_in(self, client: Client, name: str) -> SubmissionDetail:
        submission = client.submit(self._file, SUITE, name)
        while not submission.state.over:
            time.sleep(0.2)
            submission = client.submission(submission.id)
        return submission


def run(folder: Path, kills: Sequence[Blow]) -> Report:
    """Hand in, kill, let everything come to its end, and examine."""
    report = Report()
    store = File(folder)
    service = Service(
        store.url, folder / "service.log", home=folder / "home", simulators=4, spare_simulators=1, submissions=1
    )
    service.start()
    try:
        service.await_ready()
        owners = [Owner(service, folder, name) for name in MODELS]
        for owner in owners:
            owner.thread.start()
        for kill in kills:
            _wait_for(kill, service, store)
            states = [row["state"] for row in store.rows("SELECT state FROM submissions")]
            until(lambda kill=kill: _kill(kill, service), 120.0, f"nothing to kill: {kill}")
            report.kills[kill.victim] += 1
            report.during.update(state for state in states if not SubmissionState(state).over)
        for owner in owners:
            owner.last.set()
        deadline = time.monotonic() + _END_S
        for owner in owners:
            owner.thread.join(max(0.0, deadline - time.monotonic()))
            assert owner.error is None, owner.error
            assert not owner.thread.is_alive(), f"{owner.thread.name} has not finished after {_END_S:.0f} s"
        below = psutil.Process(service.pid).children(recursive=True)
    finally:
        status = service.stop()
    assert status == 0, f"the service ended with status {status}"
    _, left = psutil.wait_procs(below, timeout=10.0)
    report.bad += [f"left behind: {process}" for process in left]
    report.submissions = [submission for owner in owners for submission in owner.done]
    _examine(report, store, folder / "home" / "submissions")
    return report


def _wait_for(kill: Blow, service: Service, store: File) -> None:
    """Until the moment has come, and a submission that lost a few runners in a row has got one through."""
    if kill.phase != ANY:
        service.await_ready()
        until(lambda: _goes_on(kill.phase, service, store), _WORK_S, f"no {kill.phase} goes on")
    hurt = f"SELECT id FROM submissions WHERE attempts >= {_HURT} AND ended IS NULL"
    until(lambda: not store.rows(hurt), _END_S, "no runner gets through")
    time.sleep(kill.pause_s)
    if kill.at_write:
        store.await_write()


def _goes_on(phase: str, service: Service, store: File) -> bool:
    if phase == DRIVE:
        return bool(store.driven() - {None})  # an open episode without an evaluation is a check's practice
    waiting = store.rows("SELECT id FROM submissions WHERE state = 'queued'")
    return bool(waiting and _runners(service))


def _kill(kill: Blow, service: Service) -> bool:
    if kill.victim == SERVICE:
        return service.kill()
    found = (_runners if kill.victim == RUNNER else _sandboxes)(service)
    if not found:
        return False
    try:
        os.kill(found[int(kill.pick * len(found))].pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def _runners(service: Service) -> list[psutil.Process]:
    return _below(service.pid, lambda process: "wrongturn_runner" in process.cmdline())


def _sandboxes(service: Service) -> list[psutil.Process]:
    """Return all processes of sandboxes: bubblewrap, its second self, and the guest."""
    return [part for runner in _runners(service) for part in _below(runner.pid, lambda _process: True)]


def _below(pid: int | None, wanted: Callable[[psutil.Process], bool]) -> list[psutil.Process]:
    found = []
    try:
        for process in psutil.Process(pid).children(recursive=True) if pid is not None else ():
            try:
                if process.status() != psutil.STATUS_ZOMBIE and wanted(process):
                    found.append(process)
            except psutil.Error:
                continue
    except psutil.Error:
        return []
    return found


def _examine(report: Report, store: File, files: Path) -> None:
    """Every submission is there once, and came to what its model comes to when nothing is killed."""
    secrets = {row["id"]: row["secret"] for row in store.rows("SELECT id, secret FROM evaluations")}
    rows = {row["id"]: row for row in store.rows("SELECT * FROM submissions")}
    report.lost = len(store.rows("SELECT id FROM episodes WHERE state = 'lost' AND evaluation_id IS NOT NULL"))
    told = [submission.id for submission in report.submissions]
    if sorted(rows) != sorted(told) or len(secrets) != len(told):
        report.bad.append(f"{len(told)} were handed in; there are {len(rows)} and {len(secrets)} evaluations")
    for submission in report.submissions:
        if submission.state is not SubmissionState.FINISHED or submission.evaluation is None:
            report.bad.append(f"{submission.name} {submission.state}: {submission.reason}")
            continue
        count = len(store.rows(f"SELECT id FROM episodes WHERE state = 'finished' AND {_of(submission.evaluation)}"))
        wanted = reference(MODELS[submission.name.split()[0]], SUITE, secrets[submission.evaluation])
        got = {
            trial: (verdict, trajectory)
            for trial, (verdict, _, _, _, trajectory) in results(store, submission.evaluation).items()
        }
        if count != len(wanted):
            report.bad.append(f"{submission.name}: {count} episodes for {len(wanted)} trials")
        report.bad += [
            f"{submission.name} {trial}: {got.get(trial)} and not {result}"
            for trial, result in wanted.items()
            if got.get(trial) != result
        ]
    report.bad += [f"left behind: {file.name}" for file in files.iterdir() if file.suffix != ".onnx"]


def _of(evaluation: str) -> str:
    return f"evaluation_id = '{evaluation}'"
