"""One drive that tests repeat, and its replies when every step goes through the service."""

import contextlib
import sqlite3
from dataclasses import dataclass
from functools import cache

from lent_socket import LentSocket, lent
from service_harness import Agent, RunningService

from wrongturn_protocol import wire

TRIAL = {"town": "Town01", "approach": "J3-S", "seed": 3, "track": "privileged"}
Payloads = list[bytes]


def action(seq: int) -> tuple[float, float, float]:
    return (0.05 * (-1) ** seq, 0.4 if seq % 3 else 0.0, 0.0)


def fields(seq: int) -> dict[str, float]:
    return dict(zip(("steer", "throttle", "brake"), action(seq), strict=True))


def over(payload: bytes) -> bool:
    _, ((status, reply, *_),) = wire.unpack_results(payload)
    assert status == 200, reply
    return bool(reply["terminated"] or reply["truncated"])


@cache
def reference_of(service: RunningService) -> Payloads:
    """The replies of a whole drive, by seq, none of which was given during a loan."""
    with service.agent() as agent, LentSocket(service, agent.token) as drive:
        episode = agent.practise(**TRIAL)["id"]
        payloads = [b""]
        while len(payloads) == 1 or not over(payloads[-1]):
            seq = len(payloads)
            payloads.append(drive.unlent_step(episode, seq, action(seq)))
            assert lent(service) == 0
    assert len(payloads) > 60
    return payloads


@dataclass
class Story:
    """The drive as it is repeated, and how far it has come."""

    agent: Agent
    drive: LentSocket
    reference: Payloads
    episode: str = ""
    seq: int = 0

    def __post_init__(self) -> None:
        self.episode = self.episode or self.agent.practise(**TRIAL)["id"]

    def call(self, ahead: int = 1) -> list[object]:
        return ["step", self.episode, self.seq + ahead, *action(self.seq + ahead)]

    def step(self, drive: LentSocket | None = None) -> None:
        """Take the next step; its reply is as it was."""
        self.seq += 1
        payload = (drive or self.drive).step(self.episode, self.seq, action(self.seq))
        assert payload == self.reference[self.seq], self.seq

    def begin_loan(self) -> None:
        """Step until the connection is lent, and once more."""
        while not lent(self.drive.service):
            assert self.seq < len(self.reference) - 10, "it is never lent"
            self.step()
        self.step()

    def go_on(self, drive: LentSocket | None = None) -> None:
        """Drive to the verdict."""
        while self.seq < len(self.reference) - 1:
            self.step(drive)


def stored(service: RunningService, episode: str) -> tuple[object, ...]:
    with contextlib.closing(sqlite3.connect(f"file:{service.database}?mode=ro", uri=True)) as database:
        query = (
            "select trial_id, verdict, outcome, steps, actions_sha256, trajectory_sha256, last_action, last_reply "
            "from episodes where id = ?"
        )
        (row,) = database.execute(query, (episode,))
    assert row[4]
    return tuple(row)
