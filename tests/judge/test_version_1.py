"""Version 1, which still judges old records: standing by speed, forty seconds, four flags."""

import functools
import math

import handmade_junction
import pytest
from handmade_junction import (
    FOLLOW,
    LEFT,
    RIGHT,
    STRAIGHT,
    Legs,
    drive,
    junction,
    mirrored_rows,
    trial,
    way,
)

from wrongturn_judge import THRESHOLDS_1, judge_of
from wrongturn_protocol import Flag, Outcome, Verdict

CROSS = junction()
verdict_of = functools.partial(handmade_junction.verdict_of, thresholds=THRESHOLDS_1)


def stand(distance: float, *legs: tuple[float, float], step: float = 0.05) -> tuple[Verdict, float]:
    """Drive to ``distance`` before the stop line in a second, then follow the legs."""
    rows = drive(way(STRAIGHT, begin=distance + 8.0), [(1.0, 8.0), *legs], command=STRAIGHT, step=step)
    outcome = verdict_of(rows, CROSS, trial(route=STRAIGHT))
    return outcome.verdict, outcome.time


ON = (12.0, 8.0)


@pytest.mark.parametrize(
    ("distance", "verdict"),
    [
        (25.0, Verdict.NOT_ENGAGED),
        (16.0, Verdict.NOT_ENGAGED),
        (15.01, Verdict.NOT_ENGAGED),
        (14.99, Verdict.STOPPED_BEFORE_JUNCTION),
        (10.0, Verdict.STOPPED_BEFORE_JUNCTION),
        (0.01, Verdict.STOPPED_BEFORE_JUNCTION),
        (-0.01, Verdict.STOPPED_IN_JUNCTION),
        (-8.0, Verdict.STOPPED_IN_JUNCTION),
        (-15.99, Verdict.STOPPED_IN_JUNCTION),
        (-16.01, Verdict.TIMEOUT),
        (-20.0, Verdict.TIMEOUT),
    ],
)
def test_where_a_car_stands_is_what_its_stop_comes_to(distance: float, verdict: Verdict) -> None:
    begin = max(distance, 5.0)
    rows = drive(way(STRAIGHT, begin=begin + 8.0), [(1.0 + (begin - distance) / 8.0, 8.0), (39.1, 0.0)])
    # What is left of a step goes into the start, so that the car stands where it should to a millimetre.
    gap = rows[-1].y - (-8.0 - distance)
    outcome = verdict_of([row._replace(y=row.y - gap) for row in rows], CROSS, trial())
    assert outcome.verdict is verdict


@pytest.mark.parametrize("distance", [20.0, 10.0, -8.0])
@pytest.mark.parametrize(("seconds", "stopped"), [(1.0, False), (3.0, False), (3.05, True), (5.0, True)])
def test_a_stop_takes_three_seconds_from_the_first_slow_row(distance: float, seconds: float, stopped: bool) -> None:
    # 3.0 s of slow rows are 60 of them, 2.95 s from first to last.
    begin = max(distance, 5.0)
    way_there = 1.0 + round((begin - distance) / 8.0 / 0.05) * 0.05
    rows = drive(way(STRAIGHT, begin=begin + 8.0), [(way_there, 8.0), (seconds, 0.0), ON], command=STRAIGHT)
    outcome = verdict_of(rows, CROSS, trial())
    if stopped:
        assert outcome.verdict.stopped or outcome.verdict is Verdict.NOT_ENGAGED
        assert outcome.time == pytest.approx(way_there + 3.0)
    else:
        assert outcome.verdict is Verdict.EXIT_COMMANDED


@pytest.mark.parametrize("speed", [0.0, 0.2, 0.29, 0.2999])
def test_slower_than_the_stop_speed_is_standing(speed: float) -> None:
    assert stand(10.0, (3.05, speed), ON) == (Verdict.STOPPED_BEFORE_JUNCTION, pytest.approx(4.0))


@pytest.mark.parametrize("speed", [0.3, 0.31, 0.5])
def test_at_the_stop_speed_a_car_drives(speed: float) -> None:
    assert stand(10.0, (5.0, speed), ON)[0] is Verdict.EXIT_COMMANDED


@pytest.mark.parametrize("legs", [[(2.9, 0.0), (0.05, 0.31), (2.9, 0.0), ON], [(1.5, 0.1), (1.0, 1.0), (2.5, 0.0), ON]])
def test_an_interrupted_stop_begins_anew(legs: Legs) -> None:
    assert stand(10.0, *legs)[0] is Verdict.EXIT_COMMANDED


def test_a_car_that_creeps_over_the_line_is_timed_anew_in_the_junction() -> None:
    # 0.2 m/s: over the line after 1.5 s, so 3 s are up in the junction at 4.5 s.
    verdict, time = stand(0.3, (10.0, 0.2))
    assert verdict is Verdict.STOPPED_IN_JUNCTION
    assert time == pytest.approx(1.0 + 1.5 + 3.0, abs=0.1)


def test_a_car_that_creeps_on_before_three_seconds_in_the_junction_drives_on() -> None:
    assert stand(0.3, (4.3, 0.2), ON)[0] is Verdict.EXIT_COMMANDED
    assert stand(0.3, (4.7, 0.2), ON)[0] is Verdict.STOPPED_IN_JUNCTION


def test_a_car_that_creeps_past_fifteen_metres_is_timed_anew() -> None:
    assert stand(15.2, (2.9, 0.1), ON)[0] is Verdict.EXIT_COMMANDED
    verdict, time = stand(15.2, (10.0, 0.1))
    assert verdict is Verdict.STOPPED_BEFORE_JUNCTION
    assert time == pytest.approx(1.0 + 2.0 + 3.0, abs=0.1)


def test_standing_beyond_the_junction_is_no_stop() -> None:
    rows = drive(way(RIGHT), [(4.9, 8.0), (10.0, 0.0), (5.0, 8.0)], command=RIGHT)
    assert verdict_of(rows, CROSS, trial()).verdict is Verdict.EXIT_COMMANDED


@pytest.mark.parametrize(
    ("begin", "speed", "verdict"),
    [
        (30.0, 0.35, Verdict.NOT_ENGAGED),  # 14 m in 40 s: 16 m are left
        (29.5, 0.36, Verdict.NOT_ENGAGED),
        (30.0, 0.38, Verdict.TIMEOUT),  # 15.2 m: 14.8 m are left
        (30.0, 0.6, Verdict.TIMEOUT),
        (10.0, 0.35, Verdict.STOPPED_IN_JUNCTION),
        (10.0, 0.62, Verdict.STOPPED_IN_JUNCTION),
        (10.0, 0.70, Verdict.TIMEOUT),
    ],
)
def test_after_forty_seconds_it_counts_where_the_car_is(begin: float, speed: float, verdict: Verdict) -> None:
    rows = drive(way(STRAIGHT, begin=begin), [(40.05, speed)])
    outcome = verdict_of(rows, CROSS, trial())
    assert (outcome.verdict, outcome.time) == (verdict, 40.0)
    watching = judge_of(CROSS, trial(), THRESHOLDS_1)
    assert [watching.observe(row) for row in rows[:-1]] == [None] * 800
    assert not watching.ran_out
    assert watching.observe(rows[-1]) == outcome
    assert watching.ran_out


@pytest.mark.parametrize("begin", [30.0, 10.0, 4.0])
def test_a_record_that_ends_before_its_time_was_aborted(begin: float) -> None:
    rows = drive(way(STRAIGHT, begin=begin), [(40.0, 0.35)])
    outcome = verdict_of(rows, CROSS, trial())
    assert (outcome.verdict, outcome.time) == (Verdict.ABORTED, 39.95)


def test_a_stop_by_standing_is_not_by_time() -> None:
    watching = judge_of(CROSS, trial(), THRESHOLDS_1)
    for row in drive(way(STRAIGHT, begin=10.0), [(1.0, 2.0), (4.0, 0.0)]):
        watching.observe(row)
    assert watching.outcome is not None
    assert not watching.ran_out


def test_abort_keeps_a_verdict_that_fell() -> None:
    watching = judge_of(CROSS, trial(), THRESHOLDS_1)
    for row in drive(way(LEFT), [(10.0, 8.0)], command=FOLLOW):
        watching.observe(row)
    assert watching.outcome is not None
    assert watching.abort(99.0) is watching.outcome
    assert watching.outcome.verdict is Verdict.EXIT_ROUTE


def test_the_agent_may_abort_anywhere() -> None:
    for count in (0, 1, 50):
        watching = judge_of(CROSS, trial(), THRESHOLDS_1)
        for row in drive(way(LEFT), [(10.0, 8.0)])[:count]:
            watching.observe(row)
        outcome = watching.abort(7.0)
        assert (outcome.verdict, outcome.time, outcome.exit) == (Verdict.ABORTED, 7.0, None)


def test_in_a_mirror_a_stop_is_the_same() -> None:
    rows = drive(way(STRAIGHT, begin=10.0), [(1.0, 2.0), (4.0, 0.0)])
    here = verdict_of(rows, CROSS, trial())
    assert verdict_of(mirrored_rows(rows), CROSS.mirrored(), trial()) == here


# Flags, where version 2 has lengths.


@pytest.mark.parametrize(("lateral", "bitten"), [(0.0, False), (-1.19, False), (-1.21, True), (-1.99, True)])
def test_a_kerb_bite_is_a_flag(lateral: float, bitten: bool) -> None:
    outcome = verdict_of(drive(way(STRAIGHT, lateral=lateral), [(9.0, 8.0)], command=STRAIGHT), CROSS, trial())
    assert outcome.verdict is Verdict.EXIT_COMMANDED
    assert outcome.flags == ((Flag.KERB_BITE,) if bitten else ())


@pytest.mark.parametrize(
    ("lateral", "invades"), [(0.0, False), (1.19, False), (1.21, True), (2.0, True), (4.0, True), (-1.0, False)]
)
def test_a_wheel_in_the_oncoming_lane_is_an_invasion(lateral: float, invades: bool) -> None:
    rows = drive(way(STRAIGHT, lateral=lateral), [(1.0, 8.0)])
    assert (Flag.LANE_INVASION in verdict_of(rows, CROSS, trial()).flags) is invades


def outcome_at(x: float, y: float, yaw: float) -> Outcome:
    first = drive(way(STRAIGHT), [(1.0, 8.0)])[0]
    return verdict_of([first, first._replace(t=0.05, x=x, y=y, yaw=yaw)], CROSS, trial())


@pytest.mark.parametrize(("x", "invades"), [(-4.0, False), (-6.4, False), (-6.6, True), (-10.0, True)])
def test_a_turn_that_is_cut_invades_beyond_the_exit_line(x: float, invades: bool) -> None:
    # Heading west with the left wheels on the oncoming side of the western arm, the front ones 1.45 m ahead.
    assert (Flag.LANE_INVASION in outcome_at(x, 0.5, math.pi).flags) is invades


def test_a_lane_is_oncoming_by_the_heading() -> None:
    for yaw, invades in ((math.pi / 2, True), (0.1, True), (-0.1, False), (-math.pi / 2, False)):
        assert (Flag.LANE_INVASION in outcome_at(-2.0, -20.0, yaw).flags) is invades


@pytest.mark.parametrize(("distance", "over"), [(10.0, False), (2.31, False), (2.29, True), (1.0, True), (0.01, True)])
def test_stopped_with_the_nose_over_the_line(distance: float, over: bool) -> None:
    rows = drive(way(STRAIGHT, begin=distance + 8.0), [(1.0, 8.0), (3.05, 0.0)])
    outcome = verdict_of(rows, CROSS, trial())
    assert outcome.verdict is Verdict.STOPPED_BEFORE_JUNCTION
    assert outcome.flags == ((Flag.OVER_LINE,) if over else ())


def test_the_wrong_way_is_a_flag_too() -> None:
    outcome = verdict_of(drive(way(STRAIGHT, lateral=4.0), [(12.0, 8.0)], command=STRAIGHT), CROSS, trial())
    assert outcome.verdict is Verdict.WRONG_WAY
    assert outcome.flags == (Flag.LANE_INVASION, Flag.WRONG_WAY)


def test_there_are_no_lengths() -> None:
    outcome = verdict_of(drive(way(STRAIGHT, lateral=-1.5), [(9.0, 8.0)], command=STRAIGHT), CROSS, trial())
    assert {"kerb_bite_m", "kerb_bite_s", "opposed_lane_m", "over_line_m", "first_stop_s"} & set(
        outcome.model_dump()
    ) == set()
