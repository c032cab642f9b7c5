"""A connection that is lent to a simulator is to its client what any is, whatever comes in the middle of a loan."""

import contextlib
import sqlite3
import threading
import time
from collections.abc import Callable
from random import Random

import pytest
from drive_socket import DriveSocket
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lent_socket import LentSocket, figure, lent, until
from loan_story import TRIAL, Payloads, action, begin, fields, go_on, over, stored
from service_harness import Agent, RunningService, expect
from test_drive_frames import BINARY, PING, PONG, frame

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import decode
from wrongturn_service.simulators import action_log

# What is told, and what is stored


def test_a_lent_drive_is_an_unlent_one(
    service: RunningService, agent: Agent, drive: LentSocket, reference: Payloads
) -> None:
    names = (
        "wrongturn_steps_total",
        'wrongturn_request_seconds_count{method="WS",route="/v1/drive step",status="200"}',
    )
    before = [figure(service, name) for name in names]
    by_loans = agent.practise(**TRIAL)["id"]
    seq = begin(drive, by_loans, reference)
    go_on(drive, by_loans, reference, seq)
    steps = len(reference) - 1
    assert [figure(service, name) - been for name, been in zip(names, before, strict=True)] == [steps, steps]
    assert drive.step(by_loans, steps, action(steps)) == reference[steps]
    # Over HTTP
    by_http = agent.practise(**TRIAL)["id"]
    for seq in range(1, len(reference)):
        told = expect(agent.step(by_http, seq, fields(seq)), 200)
        _, ((_, shown, block),) = wire.unpack_results(reference[seq])
        observation = decode(told.pop("observation"), Track.PRIVILEGED)
        assert wire.block(observation, Track.PRIVILEGED) == block
        assert told == shown
    assert agent.trajectory(by_loans) == agent.trajectory(by_http)
    assert stored(service, by_loans) == stored(service, by_http)


def _trial(service: RunningService, episode: str) -> str:
    with contextlib.closing(sqlite3.connect(f"file:{service.database}?mode=ro", uri=True)) as database:
        ((trial,),) = database.execute("select trial_id from episodes where id = ?", (episode,))
    return str(trial)


def test_in_an_evaluation_no_reward_is_told(service: RunningService, agent: Agent, drive: LentSocket) -> None:
    episode = expect(agent.reset(agent.evaluate()["id"]), 201)["id"]
    lent_replies: Payloads = [b""]
    was_lent = False
    while len(lent_replies) == 1 or not over(lent_replies[-1]):
        seq = len(lent_replies)
        lent_replies.append(drive.step(episode, seq, action(seq)))
        was_lent = was_lent or bool(lent(service))
        assert wire.unpack_results(lent_replies[-1])[1][0][1].keys() == {"seq", "terminated", "truncated"}
    assert was_lent
    again = agent.evaluate()["id"]
    while _trial(service, twin := expect(agent.reset(again), 201)["id"]) != _trial(service, episode):
        agent.http.delete(f"/v1/episodes/{twin}")
    for seq in range(1, len(lent_replies)):
        assert drive.unlent_step(twin, seq, action(seq)) == lent_replies[seq]
    assert stored(service, episode) == stored(service, twin)


# What is not the next plain step

Case = Callable[[Agent, LentSocket, str, int, Payloads], int]
"""Does something after the seq that is given, and returns that of the last step that was taken."""


def _repeat(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    assert drive.step(episode, seq, action(seq)) == reference[seq]
    return seq


def _mismatch(_: Agent, drive: LentSocket, episode: str, seq: int, __: Payloads) -> int:
    status, told = drive.call("step", episode, seq, 1.0, 1.0, 0.0)
    assert (status, told["type"]) == (409, "/problems/action-mismatch")
    return seq


def _gap(_: Agent, drive: LentSocket, episode: str, seq: int, __: Payloads) -> int:
    for wrong in (seq + 2, seq - 1, 2**40):
        status, told = drive.call("step", episode, wrong, *action(seq))
        assert (status, told["type"]) == (409, "/problems/sequence-gap")
    return seq


def _another(agent: Agent, drive: LentSocket, _: str, seq: int, reference: Payloads) -> int:
    other = agent.practise(**TRIAL)["id"]
    assert drive.step(other, 1, action(1)) == reference[1]
    return seq


def _nobodys(_: Agent, drive: LentSocket, __: str, seq: int, ___: Payloads) -> int:
    status, told = drive.call("step", "ep_none", seq + 1, *action(seq + 1))
    assert (status, told["type"]) == (404, "/problems/unknown-episode")
    return seq


def _two_calls(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    drive.send(*(["step", episode, seq + at, *action(seq + at)] for at in (1, 2)), number=7)
    number, results = wire.unpack_results(drive.receive())
    assert number == 7
    assert results == [wire.unpack_results(reference[seq + at])[1][0] for at in (1, 2)]
    return seq + 2


def _whole_numbers(_: Agent, drive: LentSocket, episode: str, seq: int, __: Payloads) -> int:
    status, told = drive.call("step", episode, seq + 1, 0, 0, 3)
    assert (status, told["errors"][0]["path"]) == (422, "action.brake")
    return seq


def _an_int_for_a_float(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    steer, throttle, brake = action(seq + 1)
    drive.send(["step", episode, seq + 1, steer, throttle, int(brake)], number=seq + 1)
    assert drive.receive() == reference[seq + 1]
    return seq + 1


def _out_of_range(_: Agent, drive: LentSocket, episode: str, seq: int, __: Payloads) -> int:
    for wrong in (1.01, float("nan"), float("inf"), "fast", None):
        status, told = drive.call("step", episode, seq + 1, 0.0, wrong, 0.0)
        assert (status, told["errors"][0]["path"]) == (422, "action.throttle")
    return seq


def _look(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    status, told, block = drive.call("look", episode)
    assert (status, told["seq"], told["state"]) == (200, seq, "open")
    assert block == wire.unpack_results(reference[seq])[1][0][2]
    return seq


def _fragments(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    message = wire.pack_calls(seq + 1, [["step", episode, seq + 1, *action(seq + 1)]])
    drive.raw.sendall(frame(BINARY, message[:9], final=False) + frame(PING, b"?") + frame(0, message[9:]))
    assert sorted([drive.frame(), drive.frame()]) == [(BINARY, reference[seq + 1]), (PONG, b"?")]
    return seq + 1


def _ping(_: Agent, drive: LentSocket, __: str, seq: int, ___: Payloads) -> int:
    drive.raw.sendall(frame(PING, b"here?"))
    assert drive.frame() == (PONG, b"here?")
    return seq


def _unasked_pong(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    drive.raw.sendall(frame(PONG, b"here!"))
    assert drive.step(episode, seq + 1, action(seq + 1)) == reference[seq + 1]
    return seq + 1


def _two_pieces(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    message = frame(BINARY, wire.pack_calls(seq + 1, [["step", episode, seq + 1, *action(seq + 1)]]))
    for cut in (1, 2, 5, 6, len(message) - 1):
        drive.raw.sendall(message[:cut])
        time.sleep(0.02)
        drive.raw.sendall(message[cut:])
        assert drive.receive() == reference[seq + 1]
    return seq + 1


def _byte_by_byte(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    for byte in frame(BINARY, wire.pack_calls(seq + 1, [["step", episode, seq + 1, *action(seq + 1)]])):
        drive.raw.sendall(bytes([byte]))
    assert drive.receive() == reference[seq + 1]
    return seq + 1


def _pipelined(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    drive.raw.sendall(
        b"".join(
            frame(BINARY, wire.pack_calls(seq + at, [["step", episode, seq + at, *action(seq + at)]]))
            for at in range(1, 6)
        )
    )
    assert [drive.receive() for _ in range(5)] == reference[seq + 1 : seq + 6]
    return seq + 5


def _one_after_the_other(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    for at in range(1, 6):
        drive.send(["step", episode, seq + at, *action(seq + at)], number=seq + at)
    assert [drive.receive() for _ in range(5)] == reference[seq + 1 : seq + 6]
    return seq + 5


def _large(_: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    drive.send(*[["step", episode, seq + 1, *action(seq + 1)]] * wire.CALLS, number=5)
    _, results = wire.unpack_results(drive.receive())
    assert results == wire.unpack_results(reference[seq + 1])[1] * wire.CALLS
    drive.send(["look", "x" * 100_000], number=6)
    assert wire.unpack_results(drive.receive())[1][0][0] == 404
    return seq + 1


def _http_step(agent: Agent, _: LentSocket, episode: str, seq: int, __: Payloads) -> int:
    assert expect(agent.step(episode, seq + 1, fields(seq + 1)), 200)["seq"] == seq + 1
    return seq + 1


def _http_repeat(agent: Agent, _: LentSocket, episode: str, seq: int, __: Payloads) -> int:
    assert expect(agent.step(episode, seq, fields(seq)), 200)["seq"] == seq
    return seq


def _http_look(agent: Agent, _: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    told = expect(agent.http.get(f"/v1/episodes/{episode}"), 200)
    assert told["seq"] == seq
    observation = decode(told["last_reply"]["observation"], Track.PRIVILEGED)
    assert wire.block(observation, Track.PRIVILEGED) == wire.unpack_results(reference[seq])[1][0][2]
    return seq


def _second_socket(agent: Agent, drive: LentSocket, episode: str, seq: int, reference: Payloads) -> int:
    with LentSocket(drive.service, agent.token) as second:
        assert second.step(episode, seq, action(seq)) == reference[seq]
        for at in range(1, 9):
            turn = (drive, second)[at % 2]
            assert turn.step(episode, seq + at, action(seq + at)) == reference[seq + at]
    return seq + 8


def _another_token(agent: Agent, drive: LentSocket, _: str, seq: int, __: Payloads) -> int:
    with drive.service.agent() as other:
        expect(other.http.post(f"/v1/agents/{other.id}/token"), 201)
    return seq


CASES: list[Case] = [
    _repeat,
    _mismatch,
    _gap,
    _another,
    _nobodys,
    _two_calls,
    _whole_numbers,
    _an_int_for_a_float,
    _out_of_range,
    _look,
    _fragments,
    _ping,
    _unasked_pong,
    _two_pieces,
    _byte_by_byte,
    _pipelined,
    _one_after_the_other,
    _large,
    _http_step,
    _http_repeat,
    _http_look,
    _second_socket,
    _another_token,
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__[1:])
def test_in_the_middle_of_a_loan(agent: Agent, drive: LentSocket, reference: Payloads, case: Case) -> None:
    episode = agent.practise(**TRIAL)["id"]
    seq = begin(drive, episode, reference)
    seq = case(agent, drive, episode, seq, reference)
    seq = begin(drive, episode, reference, seq)  # it is lent again
    assert drive.step(episode, seq + 1, action(seq + 1)) == reference[seq + 1]


ANYWHERE = [case for case in CASES if case not in (_another, _another_token)]


@settings(max_examples=25, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(plan=st.lists(st.tuples(st.integers(0, 6), st.sampled_from(ANYWHERE)), min_size=1, max_size=6))
def test_any_of_it_in_any_order(
    agent: Agent, drive: LentSocket, reference: Payloads, plan: list[tuple[int, Case]]
) -> None:
    episode = agent.practise(**TRIAL)["id"]
    seq = 0
    for plain, case in [(2, _repeat), *plan]:
        for _ in range(plain):
            seq += 1
            assert drive.step(episode, seq, action(seq)) == reference[seq]
        if seq < len(reference) - 10:
            seq = case(agent, drive, episode, seq, reference)
    go_on(drive, episode, reference, seq)


def test_many_at_once_take_each_step_once(
    service: RunningService, agent: Agent, drive: LentSocket, reference: Payloads
) -> None:
    stop, looked = threading.Event(), []
    episode = ""

    def disturb(seed: int) -> None:
        dice = Random(seed)
        with DriveSocket(service, agent.token) as other:
            while not stop.wait(dice.random() * 0.02):
                if not episode:
                    continue
                if dice.random() < 0.5:
                    looked.append(expect(agent.http.get(f"/v1/episodes/{episode}"), 200).get("seq", -1))
                else:
                    assert other.one("look", episode)[0] == 200

    disturbing = [threading.Thread(target=disturb, args=(seed,)) for seed in range(2)]
    for thread in disturbing:
        thread.start()
    try:
        for _ in range(5):
            episode = agent.practise(**TRIAL)["id"]
            go_on(drive, episode, reference, 0)
    finally:
        stop.set()
        for thread in disturbing:
            thread.join()
    assert looked


def test_loans_follow_one_another(service: RunningService, agent: Agent, drive: LentSocket) -> None:
    standing = (0.0, 0.0, 1.0)
    journey = {"town": "Town01", "task": "navigation", "seed": 3, "track": "state"}
    by_loans, unlent = (expect(agent.http.post("/v1/episodes", json=journey), 201)["id"] for _ in range(2))
    # More than a loan may have, and a pause that is longer than one may last.
    seqs = range(1, action_log.STEPS + 100)
    replies = []
    for seq in seqs:
        replies.append(drive.step(by_loans, seq, standing))
        assert not over(replies[-1]), seq
        if seq == 50:
            assert lent(service)
            until(lambda: not lent(service), "silence does not end a loan")
    for seq in seqs:
        assert drive.unlent_step(unlent, seq, standing) == replies[seq - 1]
    for episode in (by_loans, unlent):
        assert agent.http.delete(f"/v1/episodes/{episode}").status_code == 204
    assert stored(service, by_loans) == stored(service, unlent)
    assert agent.trajectory(by_loans) == agent.trajectory(unlent)
