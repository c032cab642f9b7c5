"""Evaluations that go on side by side while processes are killed, and what came of them."""

import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from databases import Store
from ledger import Findings, examine, journal
from moments import CLIENT, POSTGRES, SERVICE, SIMULATOR, Moment
from processes import Kept, Service, until
from undisturbed import drive_undisturbed
from worker import HTTP, SOCKET

from wrongturn_client import Client
from wrongturn_protocol import Track

SUITE = "smoke@3"
SEATS = (("careful", HTTP, 2), ("obeys-blindly", SOCKET, 2), ("careful", SOCKET, 1))
"""Agents that drive at the same time: their policy, by which channel, and how many episodes at a time."""
PATIENCE_S = 120.0
_DRIVING_S = 20.0
_COUNTED_S = 1.5
"""Seconds in which the last replays are counted."""
RELEASE_S = 1.5
"""Seconds of silence after which a simulator goes to others: some killed clients are back before, some after."""


@dataclass
class Report:
    """What a campaign came to."""

    database: str
    kills: Counter[str] = field(default_factory=Counter)
    findings: Findings = field(default_factory=Findings)
    gone_on_with: int = 0
    """Episodes that were open when their client was killed, and were driven to their end by the one that came after."""
    replays: int = 0
    refusals: Counter[str] = field(default_factory=Counter)
    gave_up: Counter[str] = field(default_factory=Counter)
    """Why workers ended by themselves, to be started again."""
    seconds: float = 0.0

    def show(self) -> None:
        """Print it."""
        found = self.findings
        print(f"\n{self.database}, {self.seconds:.0f} s; killed by SIGKILL: {dict(self.kills)}")
        print(f"{found.evaluations} evaluations, {found.finished} verdicts, {found.acknowledged} of them acknowledged")
        print(f"{self.replays} replays, {self.gone_on_with} gone on with by the next client")
        print(f"gave up {dict(self.gave_up)}, refused {dict(self.refusals)}, voided {dict(found.voided)}")
        print(f"bad: {found.bad or 'nothing'}")


class Seat:
    """One agent, which drives one evaluation after the other until it is told that this one is the last."""

    def __init__(self, service: Service, folder: Path, name: str, drives: tuple[str, str, int]) -> None:
        self.evaluations: list[str] = []
        self.journals: list[Path] = []
        self.kills: list[float] = []
        self.last = threading.Event()
        self.error: BaseException | None = None
        self._token = ""
        self._service = service
        self._folder = folder
        self.policy, self._channel, self.parallel = drives
        self._worker: Kept | None = None
        self._name = name
        self.thread = threading.Thread(target=self._run, name=self._name, daemon=True)

    @property
    def there(self) -> bool:
        """Whether its program runs."""
        return self._worker is not None and self._worker.pid is not None

    def kill(self, back_s: float) -> bool:
        killed = self._worker is not None and self._worker.kill(back_s)
        if killed:
            self.kills.append(time.time())
        return killed

    def stop(self) -> None:
        self.last.set()
        if self._worker is not None and self.thread.is_alive():
            self._worker.stop()

    def command(self, url: str, evaluation: str) -> list[str]:
        """What drives an evaluation, or goes on with it."""
        what = [url, self._token, evaluation, SUITE, self.policy, self._channel, str(self.parallel)]
        program = str(Path(__file__).with_name("worker.py"))
        return [sys.executable, program, *what, str(self._journal(evaluation))]

    def _journal(self, evaluation: str) -> Path:
        return self._folder / f"{evaluation}.journal"

    def _run(self) -> None:
        try:
            with Client(self._service.url, patience=PATIENCE_S) as client:
                client.ready()
                self._token = client.register(self._name, Track.PRIVILEGED).token
            # One client for all evaluations: it knows that the service is there, and waits while it is started again.
            with Client(self._service.url, self._token, patience=PATIENCE_S) as client:
                client.live()
                while True:
                    self._drive_one(client)
                    if self.last.is_set():
                        return
        except BaseException as error:
            self.error = error

    def _drive_one(self, client: Client) -> None:
        evaluation = client.create_evaluation(SUITE).id
        self.evaluations.append(evaluation)
        self.journals.append(self._journal(evaluation))
        command = self.command(self._service.url, evaluation)
        self._worker = worker = Kept(command, self._folder / f"{self._name}.log", {})
        worker.start()
        while not worker.wait(1.0):
            pass


def run(store: Store, folder: Path, kills: Sequence[Moment]) -> Report:
    """Drive, kill, let everything come to its end, and examine.

    Args:
        store: an empty database.
        folder: where logs and journals go.
        kills: what is killed when.
    """
    began = time.monotonic()
    report = Report(store.name)
    service = Service(
        store.url,
        folder / "service.log",
        simulators=sum(parallel for _, _, parallel in SEATS),
        spare_simulators=1,
        lease_release_s=RELEASE_S,
    )
    service.start()
    taken: list[Seat] = []
    try:
        service.await_ready()
        driving = [Seat(service, folder, f"seat {number}", drives) for number, drives in enumerate(SEATS, 1)]
        taken += driving
        for seat in driving:
            seat.thread.start()
        disturbances = []
        for kill in kills:
            if not kill.at_once:
                service.await_ready()
                _await_driving(service)
            time.sleep(kill.pause_s)
            if kill.at_write:
                store.await_write()
            until(lambda kill=kill: _kill(kill, service, store, driving), 120.0, f"nothing to kill: {kill}")
            report.kills[kill.victim] += 1
            if kill.victim in {SERVICE, POSTGRES}:
                disturbances.append(time.time())
            with (folder / "kills.log").open("a") as log:
                log.write(f"{time.time():.3f} {kill}\n")
        for seat in driving:
            seat.last.set()
        _await(driving)
        time.sleep(_COUNTED_S)
        report.replays = service.replays
    finally:
        for seat in taken:
            seat.stop()
        status = service.stop()
    assert status == 0, f"the service ended with status {status}"
    told = journal([path for seat in taken for path in seat.journals])
    evaluations = {evaluation: seat.policy for seat in driving for evaluation in seat.evaluations}
    undisturbed = {name: drive_undisturbed(store, name, policy) for name, policy in evaluations.items()}
    report.findings = examine(store, undisturbed, told, [*service.kills, *disturbances])
    _tell(report, told, driving, store)
    report.seconds = time.monotonic() - began
    return report


def _kill(kill: Moment, service: Service, store: Store, seats: Sequence[Seat]) -> bool:
    if kill.victim == SERVICE:
        return service.kill()
    if kill.victim == POSTGRES:
        return store.kill(kill.pick)
    if kill.victim == CLIENT:
        there = [seat for seat in seats if seat.there]
        # Best one that is in the middle of an episode, which is what its successor has to find again.
        driven = store.driven()
        there = [seat for seat in there if driven.intersection(seat.evaluations)] or there
        return bool(there) and there[int(kill.pick * len(there))].kill(kill.back_s)
    assert kill.victim == SIMULATOR
    found = service.simulators()
    if not found:
        return False
    try:
        os.kill(found[int(kill.pick * len(found))], signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def _await_driving(service: Service) -> None:
    """Until somebody drives, so that a slow machine's kills hit something; where nobody does, for a while only."""
    deadline = time.monotonic() + _DRIVING_S
    while not service.driven() and time.monotonic() < deadline:
        time.sleep(0.1)


def _await(seats: Sequence[Seat], timeout_s: float = 240.0) -> None:
    deadline = time.monotonic() + timeout_s
    for seat in seats:
        seat.thread.join(max(0.0, deadline - time.monotonic()))
        if seat.error is not None:
            raise seat.error
        assert not seat.thread.is_alive(), f"{seat.thread.name} has not finished after {timeout_s:.0f} s"


def _tell(report: Report, told: list[dict[str, Any]], seats: Sequence[Seat], store: Store) -> None:
    for line in told:
        if line["what"] == "refused" and line["problem"] not in {"no-trial-available", "evaluation-finished"}:
            report.refusals[line["problem"]] += 1
        elif line["what"] == "gave up":
            report.gave_up[line["error"].split(":")[0]] += 1
    for seat in seats:
        names = ", ".join(f"'{name}'" for name in seat.evaluations)
        finished = store.rows(
            f"SELECT created, finished FROM episodes WHERE state = 'finished' AND evaluation_id IN ({names})"
        )
        report.gone_on_with += sum(
            any(row["created"] < when < row["finished"] for when in seat.kills) for row in finished
        )
