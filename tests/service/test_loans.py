"""A connection that is lent to a simulator is to its client what any is, whatever comes in the middle of a loan."""

import threading
from collections.abc import Callable
from random import Random

import pytest
from drive_socket import DriveSocket
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lent_socket import LentSocket, figure, lent, until
from loan_story import TRIAL, Payloads, Story, action, fields, over, stored
from service_harness import Agent, RunningService, expect
from test_drive_frames import BINARY, PING, PONG, frame

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import decode

# What is sent, and what is stored


@pytest.fixture
def story(agent: Agent, drive: LentSocket, reference: Payloads) -> Story:
    return Story(agent, drive, reference)


def test_a_lent_drive_is_an_unlent_one(service: RunningService, story: Story) -> None:
    names = (
        "wrongturn_steps_total",
        'wrongturn_request_seconds_count{method="WS",route="/v1/drive step",status="200"}',
    )
    before = [figure(service, name) for name in names]
    story.begin_loan()
    story.go_on()
    steps = story.seq
    assert [figure(service, name) - start for name, start in zip(names, before, strict=True)] == [steps, steps]
    assert story.drive.step(story.episode, steps, action(steps)) == story.reference[steps]
    by_http = story.agent.practise(**TRIAL)["id"]
    for seq in range(1, steps + 1):
        reply = expect(story.agent.step(by_http, seq, fields(seq)), 200)
        _, ((_, shown, block),) = wire.unpack_results(story.reference[seq])
        assert wire.block(decode(reply.pop("observation"), Track.PRIVILEGED), Track.PRIVILEGED) == block
        assert reply == shown
    assert story.agent.trajectory(story.episode) == story.agent.trajectory(by_http)
    assert stored(service, story.episode) == stored(service, by_http)


def test_in_an_evaluation_replies_have_no_reward(service: RunningService, agent: Agent, drive: LentSocket) -> None:
    episode = expect(agent.reset(agent.evaluate()["id"]), 201)["id"]
    replies: Payloads = [b""]
    was_lent = False
    while len(replies) == 1 or not over(replies[-1]):
        replies.append(drive.step(episode, len(replies), action(len(replies))))
        was_lent = was_lent or bool(lent(service))
        assert wire.unpack_results(replies[-1])[1][0][1].keys() == {"seq", "terminated", "truncated"}
    assert was_lent
    assert stored(service, episode)[3] == len(replies) - 1


def test_steps_are_counted_while_a_loan_lasts(service: RunningService, agent: Agent, drive: LentSocket) -> None:
    journey = {"town": "Town01", "task": "navigation", "seed": 3}
    episode = expect(agent.http.post("/v1/episodes", json=journey), 201)["id"]
    before = figure(service, "wrongturn_steps_total")
    seq = 0

    def counted() -> bool:
        nonlocal seq
        for _ in range(5):
            seq += 1
            assert not over(drive.step(episode, seq, (0.0, 0.0, 1.0)))
        return bool(lent(service)) and figure(service, "wrongturn_steps_total") - before > 5

    until(counted, "nothing is counted")
    assert agent.http.delete(f"/v1/episodes/{episode}").status_code == 204


# What is not the next plain step

Case = Callable[[Story], None]
"""Does something in the middle of a loan; the story goes on after it."""


def _refused(status: int, kind: str, *call: object) -> Case:
    """A step that is refused; integers and None in place of episode and seq are filled in."""
    _, episode, ahead, *values = call

    def case(story: Story) -> None:
        seq = story.seq + int(str(ahead))
        result, problem = story.drive.call("step", episode or story.episode, seq, *(values or action(seq)))
        path = [error["path"] for error in problem["errors"]]
        assert (result, problem["type"].removeprefix("/problems/") if not path else path[0]) == (status, kind)

    return case


def _repeat(story: Story) -> None:
    assert story.drive.step(story.episode, story.seq, action(story.seq)) == story.reference[story.seq]


def _another(story: Story) -> None:
    Story(story.agent, story.drive, story.reference).step()


def _two_calls(story: Story) -> None:
    story.drive.send(story.call(1), story.call(2), number=7)
    number, results = wire.unpack_results(story.drive.receive())
    story.seq += 2
    assert number == 7
    assert results == [wire.unpack_results(story.reference[seq])[1][0] for seq in (story.seq - 1, story.seq)]


def _an_int_for_a_float(story: Story) -> None:
    story.seq += 1
    steer, throttle, brake = action(story.seq)
    story.drive.send(["step", story.episode, story.seq, steer, throttle, int(brake)], number=story.seq)
    assert story.drive.receive() == story.reference[story.seq]


def _look(story: Story) -> None:
    status, detail, block = story.drive.call("look", story.episode)
    assert (status, detail["seq"], detail["state"]) == (200, story.seq, "open")
    assert block == wire.unpack_results(story.reference[story.seq])[1][0][2]


def _frame(story: Story) -> bytes:
    """The next step."""
    story.seq += 1
    return frame(BINARY, wire.pack_calls(story.seq, [story.call(0)]))


def _fragments(story: Story) -> None:
    story.seq += 1
    message = wire.pack_calls(story.seq, [story.call(0)])
    story.drive.raw.sendall(frame(BINARY, message[:9], final=False) + frame(PING, b"?") + frame(0, message[9:]))
    assert sorted([story.drive.frame(), story.drive.frame()]) == [(BINARY, story.reference[story.seq]), (PONG, b"?")]


def _ping(story: Story) -> None:
    story.drive.raw.sendall(frame(PING, b"here?"))
    assert story.drive.frame() == (PONG, b"here?")


def _unasked_pong(story: Story) -> None:
    story.drive.raw.sendall(frame(PONG, b"here!"))
    story.step()


def _byte_by_byte(story: Story) -> None:
    for byte in _frame(story):
        story.drive.raw.sendall(bytes([byte]))
    assert story.drive.receive() == story.reference[story.seq]


def _pipelined(story: Story) -> None:
    story.drive.raw.sendall(b"".join(_frame(story) for _ in range(5)))
    assert [story.drive.receive() for _ in range(5)] == story.reference[story.seq - 4 : story.seq + 1]


def _one_after_the_other(story: Story) -> None:
    for _ in range(5):
        story.drive.raw.sendall(_frame(story))
    assert [story.drive.receive() for _ in range(5)] == story.reference[story.seq - 4 : story.seq + 1]


def _large(story: Story) -> None:
    story.drive.send(*[story.call()] * wire.CALLS, number=5)
    story.seq += 1
    _, results = wire.unpack_results(story.drive.receive())
    assert results == wire.unpack_results(story.reference[story.seq])[1] * wire.CALLS


def _http_step(story: Story) -> None:
    story.seq += 1
    assert expect(story.agent.step(story.episode, story.seq, fields(story.seq)), 200)["seq"] == story.seq


def _http_look(story: Story) -> None:
    detail = expect(story.agent.http.get(f"/v1/episodes/{story.episode}"), 200)
    assert detail["seq"] == story.seq
    observation = decode(detail["last_reply"]["observation"], Track.PRIVILEGED)
    assert wire.block(observation, Track.PRIVILEGED) == wire.unpack_results(story.reference[story.seq])[1][0][2]


def _second_socket(story: Story) -> None:
    with LentSocket(story.drive.service, story.agent.token) as second:
        for turn in (second, story.drive) * 3:
            story.step(turn)


def _another_token(story: Story) -> None:
    with story.drive.service.agent() as other:
        expect(other.http.post(f"/v1/agents/{other.id}/token"), 201)


def _silence(story: Story) -> None:
    until(lambda: not lent(story.drive.service), "silence does not end a loan")


CASES: list[Case] = [
    _refused(409, "action-mismatch", "step", None, 0, 1.0, 1.0, 0.0),
    _refused(409, "sequence-gap", "step", None, 2),
    _refused(409, "sequence-gap", "step", None, -1),
    _refused(409, "sequence-gap", "step", None, 2**40),
    _refused(404, "unknown-episode", "step", "ep_none", 1),
    _refused(422, "action.brake", "step", None, 1, 0, 0, 3),
    _refused(422, "action.throttle", "step", None, 1, 0.0, float("nan"), 0.0),
    _refused(422, "action.throttle", "step", None, 1, 0.0, "fast", 0.0),
    _repeat,
    _two_calls,
    _an_int_for_a_float,
    _look,
    _fragments,
    _ping,
    _unasked_pong,
    _byte_by_byte,
    _pipelined,
    _one_after_the_other,
    _large,
    _http_step,
    _http_look,
    _second_socket,
]


@pytest.mark.parametrize("first", range(4))
def test_in_the_middle_of_a_loan(story: Story, first: int) -> None:
    for case in [*CASES, _another, _another_token, _silence][first::4]:
        if story.seq > len(story.reference) - 25:
            story.go_on()
            story = Story(story.agent, story.drive, story.reference)
        story.begin_loan()
        case(story)
        story.step()
    story.go_on()


def test_the_answer_to_a_ping_of_before_does_not_put_off_the_next_loan(story: Story) -> None:
    service = story.drive.service
    while not lent(service):
        story.step()
    story.drive.raw.sendall(frame(PONG, b"here!"))
    until(lambda: not lent(service), "the pong ends no loan")
    before = story.seq
    while not lent(service):
        story.step()
    assert story.seq < before + 10
    story.go_on()


@settings(max_examples=10, suppress_health_check=list(HealthCheck))
@given(plan=st.lists(st.tuples(st.integers(0, 6), st.sampled_from(CASES)), min_size=3, max_size=6))
def test_any_of_it_in_any_order(
    agent: Agent, drive: LentSocket, reference: Payloads, plan: list[tuple[int, Case]]
) -> None:
    story = Story(agent, drive, reference)
    for plain, case in [(2, _repeat), *plan]:
        for _ in range(plain):
            story.step()
        case(story)
    story.go_on()


def test_many_at_once_take_each_step_once(service: RunningService, story: Story) -> None:
    stop, looks, begun = threading.Event(), [], [threading.Event(), threading.Event()]

    def disturb(seed: int) -> None:
        dice = Random(seed)
        with DriveSocket(service, story.agent.token) as other:
            while not stop.wait(dice.random() * 0.02):
                if seed:
                    looks.append(expect(story.agent.http.get(f"/v1/episodes/{story.episode}"), 200).get("seq", -1))
                else:
                    assert other.one("look", story.episode)[0] == 200
                begun[seed].set()

    disturbing = [threading.Thread(target=disturb, args=(seed,)) for seed in range(2)]
    for thread in disturbing:
        thread.start()
    try:
        assert all(event.wait(60) for event in begun)
        story.go_on()
    finally:
        stop.set()
        for thread in disturbing:
            thread.join()
    assert looks
