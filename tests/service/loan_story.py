"""One drive that tests repeat, and the replies to it that no loan had a hand in."""

import contextlib
import sqlite3
from functools import cache

from lent_socket import LentSocket, lent
from service_harness import RunningService

from wrongturn_protocol import wire

TRIAL = {"town": "Town01", "approach": "J3-S", "seed": 3, "track": "privileged"}
Payloads = list[bytes]


def action(seq: int) -> tuple[float, float, float]:
    return (0.05 * (-1) ** seq, 0.4 if seq % 3 else 0.0, 0.0)


def fields(seq: int) -> dict[str, float]:
    return dict(zip(("steer", "throttle", "brake"), action(seq), strict=True))


def over(payload: bytes) -> bool:
    _, ((status, told, *_),) = wire.unpack_results(payload)
    assert status == 200, told
    return bool(told["terminated"] or told["truncated"])


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


def begin(drive: LentSocket, episode: str, reference: Payloads, seq: int = 0) -> int:
    """Step until the connection is lent; the last step's seq."""
    while True:
        seq += 1
        assert drive.step(episode, seq, action(seq)) == reference[seq]
        if lent(drive.service):
            return seq
        assert seq < 40, "it is never lent"


def go_on(drive: LentSocket, episode: str, reference: Payloads, seq: int) -> None:
    """From after that step to the verdict, all as it was."""
    for later in range(seq + 1, len(reference)):
        assert drive.step(episode, later, action(later)) == reference[later], later


def stored(service: RunningService, episode: str) -> tuple[object, ...]:
    with contextlib.closing(sqlite3.connect(f"file:{service.database}?mode=ro", uri=True)) as database:
        query = (
            "select trial_id, verdict, outcome, steps, actions_sha256, trajectory_sha256, last_action, last_reply "
            "from episodes where id = ?"
        )
        (row,) = database.execute(query, (episode,))
    assert row[4]
    return tuple(row)
