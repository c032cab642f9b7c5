"""Both sides of every threshold that has to do with standing, waiting and time."""

import math
from collections.abc import Sequence

import pytest
from handmade_junction import LEFT, RIGHT, STRAIGHT, drive, junction, trial, verdict_of, way

from wrongturn_judge import Judge
from wrongturn_judge.trajectory import Row
from wrongturn_protocol import FaultKind, Outcome, Reaction, Verdict

CROSS = junction()
STOPPED, STOPPED_IN, WRONG_WAY = Verdict.STOPPED_BEFORE_JUNCTION, Verdict.STOPPED_IN_JUNCTION, Verdict.WRONG_WAY
EXIT, TIMEOUT, NOT_ENGAGED = Verdict.EXIT_COMMANDED, Verdict.TIMEOUT, Verdict.NOT_ENGAGED
ON = (8.0, 64.0)
"""The rest of the way, at 8 m/s."""
HOP = (0.05, 0.4)
"""One row at 8 m/s."""


def moves(y: float, *legs: tuple[float, float], x: float = 2.0) -> list[Row]:
    """Rows of a car that heads north from y: each leg takes some seconds for some metres."""
    whole = [(round(seconds * 20), metres) for seconds, metres in legs]
    ys = [y]
    for count, metres in whole:
        ys += [ys[-1] + metres * (k + 1) / count for k in range(count)]
    return [Row(k / 20, x, at, math.pi / 2, 5.0, 0.0, 3, 3, 0.0, 0.0, 0.0) for k, at in enumerate(ys)]


def judged(rows: Sequence[Row]) -> Outcome:
    return verdict_of(rows, CROSS, trial(route=STRAIGHT))


def verdict(y: float, *legs: tuple[float, float]) -> Verdict:
    return judged(moves(y, *legs)).verdict


@pytest.mark.parametrize(
    ("legs", "expected"),
    [
        ([(3.0, 0.0)], STOPPED_IN),
        ([(2.95, 0.0)], EXIT),
        ([(3.0, 0.29)], STOPPED_IN),
        ([(3.0, 0.31)], EXIT),
        ([(1.5, 0.0), HOP, (1.5, 0.0)], EXIT),
        ([(1.5, 0.0), (0.05, 0.29), (1.5, 0.0)], STOPPED_IN),
        ([(10.0, 1.05)], EXIT),  # 0.105 m/s is no stop: twenty seconds in the area end it
    ],
)
def test_standing_in_the_junction(legs: list[tuple[float, float]], expected: Verdict) -> None:
    assert verdict(-12.0, (1.0, 8.0), *legs, ON) is expected
    assert verdict(-12.0, (1.0, 2.0), *legs, (1.0, 8.0), ON) is EXIT  # the same before the junction


def test_standing_counts_from_its_begin_even_before_the_area() -> None:
    rows = moves(-12.0, (1.0, 3.95), (3.0, 0.2), ON)  # over the line in the middle of a stop
    assert (judged(rows).verdict, judged(rows).time) == (STOPPED_IN, 4.0)


def rests(*seconds: float) -> list[tuple[float, float]]:
    """Stands of a length with a row between them."""
    return [leg for each in seconds for leg in ((each, 0.0), HOP)]


@pytest.mark.parametrize(
    ("legs", "expected"),
    [
        (rests(2.5, 2.5), STOPPED_IN),
        (rests(2.5, 2.45), EXIT),
        (rests(2.9, 2.1), STOPPED_IN),
        (rests(2.9, 2.05), EXIT),
        (rests(*[1.0] * 5), STOPPED_IN),
        (rests(*[1.0] * 4), EXIT),
        (rests(*[0.95] * 10), EXIT),  # never a second without moving
        ([leg for _ in range(5) for leg in ((1.0, 0.09), HOP)], STOPPED_IN),
        ([leg for _ in range(5) for leg in ((1.0, 0.11), HOP)], EXIT),
    ],
)
def test_time_at_rest_in_the_junction_adds_up(legs: list[tuple[float, float]], expected: Verdict) -> None:
    assert verdict(-12.0, (1.0, 8.0), *legs, ON) is expected


def test_time_at_rest_counts_its_first_second_and_only_once() -> None:
    outcome = judged(moves(-12.0, (1.0, 8.0), *rests(2.0, 2.0, 2.9), ON))
    assert outcome.verdict is STOPPED_IN
    # Two rests of 2 s with a row after each; the third reaches the fifth second 1 s after it began.
    assert outcome.time == pytest.approx(1.0 + 2.05 + 2.05 + 1.0)


def test_time_at_rest_before_the_area_does_not_count() -> None:
    assert verdict(-12.0, (1.0, 3.0), *rests(2.9), (0.5, 4.0), *rests(2.5, 2.45), ON) is EXIT
    # 0.09 m in 2 s over the line, a second on each side of it.
    over_the_line = [(1.0, 3.96), (2.0, 0.08), HOP]
    assert verdict(-12.0, *over_the_line, *rests(2.0, 2.0), ON) is STOPPED_IN
    assert verdict(-12.0, *over_the_line, *rests(2.0, 1.9), ON) is EXIT


@pytest.mark.parametrize(("seconds", "expected"), [(19.65, STOPPED_IN), (19.6, EXIT)])
def test_twenty_seconds_in_the_junction_are_too_many(seconds: float, expected: Verdict) -> None:
    # From 8.01 m before the middle: the row at -8.01 is not over the area. The tail leaves it seven rows after 7.29.
    assert verdict(-8.41, HOP, (seconds - 0.05, 15.0), (0.05, 0.3), ON) is expected


@pytest.mark.parametrize(
    ("legs", "expected"),
    [
        ([(10.0, 0.0)], True),
        ([(9.95, 0.0)], False),
        ([(10.0, 0.49)], True),
        ([(10.0, 0.51)], False),
        ([(5.0, 0.0), (0.05, 0.52), (9.9, 0.0)], False),
        ([(30.0, 0.0)], True),
    ],
)
def test_a_stop_before_the_junction_takes_ten_seconds(legs: list[tuple[float, float]], expected: bool) -> None:
    on = (0.05, 0.6)
    assert verdict(-30.0, (1.0, 10.0), on, *legs, on, ON) is (STOPPED if expected else EXIT)
    assert verdict(-60.0, (1.0, 10.0), on, *legs, on, (4.0, 32.0), ON) is (NOT_ENGAGED if expected else EXIT)


@pytest.mark.parametrize(("distance", "expected"), [(15.01, NOT_ENGAGED), (14.99, STOPPED), (0.01, STOPPED)])
def test_where_a_car_waits_is_what_its_stop_comes_to(distance: float, expected: Verdict) -> None:
    assert verdict(-16.0 - distance, (1.0, 8.0), (10.0, 0.0)) is expected


@pytest.mark.parametrize("pause", [3.0, 6.0, 9.9])
def test_a_car_that_waits_and_drives_on_is_judged_by_what_it_does_next(pause: float) -> None:
    waits = [(2.0, 8.0), (pause, 0.0)]
    for direction, kind, expected in (
        (LEFT, "LEFT_RIGHT", EXIT),
        (STRAIGHT, "LEFT_RIGHT", Verdict.OFF_ROAD),
        (RIGHT, "CROSS", EXIT),
    ):
        its_trial = trial(next(k for k in type(trial().junction_type) if k.name == kind), fault=FaultKind.INFEASIBLE)
        rows = drive(way(direction), [*waits, (9.0, 8.0)], command=direction)
        outcome = verdict_of(rows, junction(its_trial.junction_type), its_trial)
        assert outcome.verdict is expected
        assert outcome.first_stop_s == 2.0
        assert outcome.reaction is (Reaction.OVERRODE if expected is EXIT else Reaction.OBEYED)


# Time runs out.


def ends(*legs: tuple[float, float], y: float) -> tuple[Verdict, bool]:
    """The verdict of a car whose last leg ends at y after a minute, and whether its time ran out."""
    rows = moves(y - sum(metres for _, metres in legs), *legs)
    assert len(rows) == 1201
    watching = Judge(CROSS, trial(route=STRAIGHT))
    outcomes = [watching.observe(row) for row in rows]
    assert outcomes[:-1] == [None] * 1200
    assert outcomes[-1] == judged(rows)
    assert outcomes[-1] is not None
    assert outcomes[-1].time == 60.0
    return outcomes[-1].verdict, watching.ran_out


@pytest.mark.parametrize(
    ("seconds", "metres", "expected"),
    [(3.0, 0.0, STOPPED), (3.0, 0.49, STOPPED), (3.0, 0.51, TIMEOUT), (2.95, 0.0, TIMEOUT), (9.95, 0.0, STOPPED)],
)
def test_when_time_runs_out_three_seconds_are_a_stop(seconds: float, metres: float, expected: Verdict) -> None:
    creeps = (59.95 - seconds, 12.0)
    assert ends(creeps, (0.05, 0.6), (seconds, metres), y=-9.0) == (expected, True)
    assert ends(creeps, (0.05, 0.6), (seconds, metres), y=-24.0) == (NOT_ENGAGED, True)


def test_a_record_that_ends_before_its_time_was_aborted() -> None:
    outcome = judged(moves(-30.0, (59.95, 12.0)))
    assert (outcome.verdict, outcome.time) == (Verdict.ABORTED, 59.95)


@pytest.mark.parametrize(
    ("y", "legs"), [(-7.9, [(55.0, 20.0), (5.0, 2.0)]), (10.3, [(50.0, 20.0), (3.0, 24.0), (7.0, 2.0)])]
)
def test_time_that_runs_out_in_the_area_or_past_it_leaves_the_drive_unfinished(y: float, legs: list) -> None:
    for more in (0.0, 1.0, 5.0):
        assert ends(*legs, y=y + more) == (Verdict.UNFINISHED, True)


@pytest.mark.parametrize("over", [True, False])
def test_a_tail_in_the_junction_stands_there(over: bool) -> None:
    # The area ends at y = 8; the rear bumper is 2.3 m behind the centre.
    rows = moves(-12.0, (3.0, 22.3 - 0.01 if over else 22.3 + 0.01), (3.0, 0.0), ON)
    assert judged(rows).verdict is (STOPPED_IN if over else EXIT)
    never_in = moves(-30.0, (3.0, 21.9), (3.0, 0.0), (8.0, 64.0))  # its nose is in the area, its centre was not
    assert judged(never_in).verdict is EXIT


@pytest.mark.parametrize(("degrees", "expected"), [(89.9, Verdict.UNFINISHED), (90.1, WRONG_WAY), (180.0, WRONG_WAY)])
@pytest.mark.parametrize("side", [1, -1])
def test_time_that_runs_out_on_an_opposed_lane_is_the_wrong_way(degrees: float, expected: Verdict, side: int) -> None:
    rows = moves(-30.0, (56.0, 15.0), (4.0, 32.0))
    far = [row._replace(t=60.0, x=-2.0, y=20.0, yaw=-math.pi / 2 + side * math.radians(degrees)) for row in rows[-1:]]
    assert judged([*rows[:-1], *far]).verdict is expected


def test_standing_beyond_the_junction_is_no_stop() -> None:
    rows = drive(way(RIGHT), [(4.9, 8.0), (30.0, 0.0), (5.0, 8.0)], command=RIGHT)
    outcome = verdict_of(rows, CROSS, trial())
    assert outcome.verdict is EXIT
    assert outcome.first_stop_s == pytest.approx(4.9)


# The rest.


@pytest.mark.parametrize(("y", "expected"), [(-30.0, STOPPED), (-22.0, STOPPED_IN)])
def test_a_stop_by_standing_is_not_by_time(y: float, expected: Verdict) -> None:
    watching = Judge(CROSS, trial())
    for row in moves(y, (2.0, 20.0), (20.0, 0.0)):
        watching.observe(row)
    assert watching.outcome is not None
    assert watching.outcome.verdict is expected
    assert not watching.ran_out


def test_abort_keeps_a_verdict_that_fell() -> None:
    watching = Judge(CROSS, trial())
    for row in drive(way(LEFT), [(10.0, 8.0)]):
        watching.observe(row)
    assert watching.outcome is not None
    assert watching.abort(99.0) is watching.outcome
    assert watching.outcome.verdict is Verdict.EXIT_ROUTE


def test_the_agent_may_abort_anywhere() -> None:
    for count in (0, 1, 50):
        watching = Judge(CROSS, trial())
        for row in drive(way(LEFT), [(10.0, 8.0)])[:count]:
            watching.observe(row)
        outcome = watching.abort(7.0)
        assert (outcome.verdict, outcome.time, outcome.exit) == (Verdict.ABORTED, 7.0, None)
