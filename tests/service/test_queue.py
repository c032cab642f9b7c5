"""The queue for simulators: who is next, what a position means, and whose place is kept."""

import pytest
from app_harness import Clock

from wrongturn_service.episodes.queue import LONGEST_S, SLACK_S, SimulatorQueue
from wrongturn_service.errors import UnavailableError


def _line(slots: int, clock: Clock | None = None, each: int = 64, most: int = 1024) -> SimulatorQueue:
    return SimulatorQueue(lambda: slots, each, most, clock or Clock())


def _at(agent: str, address: str = "here") -> tuple[str, str, str]:
    return address, f"owner of {agent}", agent


def _refused(line: SimulatorQueue, agent: str, call: str) -> UnavailableError:
    with pytest.raises(UnavailableError) as caught:
        line.enter(_at(agent), call)
    return caught.value


def _position(line: SimulatorQueue, agent: str, call: str) -> int | None:
    return _refused(line, agent, call).position


def test_an_agent_that_asks_for_many_does_not_keep_out_who_asks_for_one() -> None:
    line = _line(4)
    for call in range(4):
        line.enter(_at("greedy"), str(call))
    assert [_position(line, "greedy", f"more {call}") for call in range(10)] == list(range(1, 11))
    assert _position(line, "modest", "0") == 1
    assert _position(line, "greedy", "more 0") == 2
    line.leave(_at("greedy"))
    assert _position(line, "greedy", "more 0") == 1
    line.enter(_at("modest"), "0")
    # Of those that wait one after the other has its turn, the one with fewer simulators first.
    assert [_position(line, "modest", str(call)) for call in (1, 2, 3)] == [1, 2, 4]
    assert _position(line, "greedy", "more 0") == 3


def test_a_place_is_kept_for_who_comes_back_in_time() -> None:
    clock = Clock()
    line = _line(1, clock)
    line.enter(_at("holder"), "0")
    first = _refused(line, "gone", "0")
    wait = int(first.headers["Retry-After"])
    _refused(line, "patient", "0")
    clock.now += wait + SLACK_S / 2
    assert _position(line, "patient", "0") == 2
    clock.now += SLACK_S
    assert _position(line, "patient", "0") == 1
    line.leave(_at("holder"))
    line.enter(_at("patient"), "0")
    assert line.waiting == 0


def test_who_is_far_behind_is_asked_to_come_back_later() -> None:
    line = _line(2)
    line.enter(_at("holder"), "0")
    line.enter(_at("holder"), "1")
    waits = [int(_refused(line, f"a{number}", "0").headers["Retry-After"]) for number in range(60)]
    assert waits[:2] == [1, 1]
    assert waits == sorted(waits)
    assert waits[-1] == LONGEST_S


def test_addresses_take_turns_however_many_agents_each_has() -> None:
    line = _line(1)
    line.enter(_at("holder"), "0")
    for number in range(20):
        _refused(line, f"crowd {number}", "0")
    line.leave(_at("holder"))
    line.enter(_at("crowd 0"), "0")
    assert line.position(_at("alone", "there"), "0") == 1
    assert line.position(_at("another"), "0") == 20
