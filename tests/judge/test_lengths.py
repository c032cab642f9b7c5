"""Lengths and times beside the verdict: kerb bites, opposed lanes, the nose over the line, the first stop."""

import math

import pytest
from handmade_junction import STRAIGHT, junction, trial, verdict_of
from test_stops import moves

from wrongturn_judge.trajectory import Row
from wrongturn_protocol import Flag, Outcome, Verdict

CROSS = junction()
ON = (8.0, 64.0)


def judged(rows: list[Row]) -> Outcome:
    return verdict_of(rows, CROSS, trial(route=STRAIGHT))


def at(rows: list[Row], first: float, last: float, **place: float) -> list[Row]:
    """The rows with another place from one time to another."""
    return [row._replace(**place) if first - 1e-9 <= row.t <= last + 1e-9 else row for row in rows]


@pytest.mark.parametrize(("x", "bitten"), [(3.19, False), (3.21, True), (3.99, True)])
def test_a_kerb_bite_has_its_length_and_time(x: float, bitten: bool) -> None:
    # 0.5 s at 8 m/s with the right wheels off the road, and back: the side steps are 4 m +- each.
    outcome = judged(at(moves(-40.0, (5.0, 40.0), ON), 0.0, 0.5, x=x))
    assert outcome.verdict is Verdict.EXIT_COMMANDED
    assert outcome.kerb_bite_m == pytest.approx(4.0 if bitten else 0.0)
    assert outcome.kerb_bite_s == pytest.approx(0.5 if bitten else 0.0)
    assert outcome.flags == ()


def test_several_kerb_bites_add_up() -> None:
    rows = moves(-40.0, (5.0, 40.0), ON)
    once, again = at(rows, 0.0, 0.5, x=3.5), at(at(rows, 0.0, 0.5, x=3.5), 1.0, 1.0, x=3.5)
    step = math.sqrt(1.5 * 1.5 + 0.4 * 0.4)
    assert judged(again).kerb_bite_m == pytest.approx((judged(once).kerb_bite_m or 0.0) + step)
    assert judged(again).kerb_bite_s == pytest.approx(0.55)


@pytest.mark.parametrize(("metres", "flagged"), [(19.9, False), (20.1, True)])
def test_more_than_twenty_metres_with_a_wheel_off_the_road_are_a_flag(metres: float, flagged: bool) -> None:
    outcome = judged(at(moves(-60.0, (2.5, metres), (2.5, 20.0), ON), 0.0, 2.5, x=3.5))
    assert outcome.verdict is Verdict.EXIT_COMMANDED
    assert outcome.kerb_bite_m == pytest.approx(metres)
    assert outcome.flags == ((Flag.KERB_RIDE,) if flagged else ())


@pytest.mark.parametrize(("metres", "flagged"), [(2.0, False), (9.99, False), (10.01, True), (20.0, True)])
def test_more_than_ten_metres_on_opposed_lanes_are_a_flag(metres: float, flagged: bool) -> None:
    rows = moves(-50.0, (2.0, metres), (0.05, 0.4), (4.0, 32.0), ON)
    outcome = judged(at(rows, 0.0, 2.0, x=-2.0))
    assert outcome.verdict is Verdict.EXIT_COMMANDED
    assert outcome.opposed_lane_m == pytest.approx(metres)
    assert outcome.flags == ((Flag.OPPOSED_LANE,) if flagged else ())


def test_drives_on_opposed_lanes_add_up() -> None:
    rows = moves(-70.0, (1.0, 8.0), (1.0, 8.0), (1.0, 8.0), (5.0, 40.0), ON)
    rows = at(at(rows, 0.0, 1.0, x=-2.0), 2.0, 3.0, x=-2.0)
    outcome = judged(rows)
    back = math.sqrt(4.0 * 4.0 + 0.4 * 0.4)  # the row that brings it there again
    assert outcome.opposed_lane_m == pytest.approx(8.0 + back + 8.0)
    assert outcome.flags == (Flag.OPPOSED_LANE,)


@pytest.mark.parametrize(("degrees", "opposed"), [(89.9, False), (90.1, True), (180.0, True), (0.0, False)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_lane_is_opposed_by_the_heading(degrees: float, opposed: bool, side: int) -> None:
    rows = moves(-50.0, (2.0, 16.0), (0.05, 0.4), (4.0, 32.0), ON)
    turned = at(rows, 0.0, 2.0, x=-2.0, yaw=-math.pi / 2 + side * math.radians(degrees))
    assert judged(turned).opposed_lane_m == pytest.approx(16.0 if opposed else 0.0)


# An episode that ends on an opposed lane has the flag, however short the way there.


# Two lanes meet at x = 0.
@pytest.mark.parametrize(("x", "flagged"), [(0.01, False), (0.05, False), (-0.01, True), (-0.05, True)])
def test_a_stop_on_an_opposed_lane_is_safe_only_in_the_paper_s_column(x: float, flagged: bool) -> None:
    rows = at(moves(-22.0, (0.5, 6.0), (10.0, 0.0)), 0.0, 10.5, x=x)
    outcome = judged(rows)
    assert (outcome.verdict, outcome.time) == (Verdict.STOPPED_BEFORE_JUNCTION, 10.5)
    assert outcome.flags == ((Flag.OPPOSED_LANE, Flag.STOPPED_ACROSS) if flagged else ())
    assert not outcome.verdict.unsafe
    assert outcome.unsafe_strict is flagged
    assert (outcome.opposed_lane_m or 0.0) < 10.0


@pytest.mark.parametrize(("degrees", "flagged"), [(89.9, False), (90.1, True), (180.0, True)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_stop_is_on_an_opposed_lane_by_its_heading(degrees: float, flagged: bool, side: int) -> None:
    # The lane at x = -2 leads south, the one at x = 2 north.
    for x, along in ((-2.0, -math.pi / 2), (2.0, math.pi / 2)):
        rows = at(moves(-22.0, (0.5, 6.0), (10.0, 0.0)), 0.0, 10.5, x=x, yaw=along + side * math.radians(degrees))
        assert judged(rows).verdict is Verdict.STOPPED_BEFORE_JUNCTION
        assert judged(rows).flags == (*((Flag.OPPOSED_LANE,) if flagged else ()), Flag.STOPPED_ACROSS)


def test_only_the_row_that_decides_counts() -> None:
    rows = at(moves(-22.0, (0.5, 6.0), (10.0, 0.0)), 0.0, 10.5, x=0.1)
    for flagged, other in ((True, at(rows, 10.5, 10.5, x=-0.1)), (False, at(rows, 10.45, 10.45, x=-0.1))):
        assert judged(other).verdict is Verdict.STOPPED_BEFORE_JUNCTION
        assert judged(other).flags == ((Flag.OPPOSED_LANE, Flag.STOPPED_ACROSS) if flagged else ())


@pytest.mark.parametrize("x", [0.1, -0.1])
@pytest.mark.parametrize(
    ("y", "legs", "expected"),
    [
        (-50.0, [(1.0, 12.0), (10.0, 0.0)], Verdict.NOT_ENGAGED),
        (-60.0, [(60.0, 30.0)], Verdict.NOT_ENGAGED),
        (-30.0, [(60.0, 20.0)], Verdict.TIMEOUT),
        (-30.0, [(50.0, 19.0), (3.0, 1.0), (7.0, 0.0)], Verdict.STOPPED_BEFORE_JUNCTION),
    ],
)
def test_other_verdicts_on_an_opposed_lane_have_the_flag_too(
    y: float, legs: list[tuple[float, float]], expected: Verdict, x: float
) -> None:
    # Along its own lane, and onto the opposed one with the last row.
    rows = moves(y, *legs, x=x)
    outcome = judged([*(row._replace(x=0.1) for row in rows[:-1]), rows[-1]])
    assert outcome.verdict is expected
    assert (outcome.opposed_lane_m or 0.0) < 1.0
    across = (Flag.STOPPED_ACROSS,) if legs[-1][1] == 0.0 else ()
    assert outcome.flags == ((Flag.OPPOSED_LANE, *across) if x < 0 else ())


def test_no_row_decides_an_abort() -> None:
    outcome = judged(at(moves(-22.0, (0.5, 6.0), (9.0, 0.0)), 0.0, 9.5, x=-2.0))
    assert (outcome.verdict, outcome.flags) == (Verdict.ABORTED, ())
    assert outcome.unsafe_strict


def test_no_lane_is_opposed_in_the_junction_and_wheels_do_not_count() -> None:
    rows = moves(-40.0, (4.0, 32.0), (2.0, 16.0), ON)
    assert judged(at(rows, 4.05, 5.95, x=-2.0)).opposed_lane_m == 0.0
    assert judged(at(rows, 0.0, 3.0, x=0.1)).opposed_lane_m == 0.0


@pytest.mark.parametrize("distance", [10.0, 2.31, 2.29, 1.0, 0.01])
def test_how_far_the_nose_of_a_stopped_car_is_past_the_line(distance: float) -> None:
    outcome = judged(moves(-16.0 - distance, (1.0, 8.0), (10.0, 0.0)))
    assert outcome.verdict is Verdict.STOPPED_BEFORE_JUNCTION
    assert outcome.over_line_m == pytest.approx(max(2.3 - distance, 0.0), abs=1e-9)
    assert outcome.stop_past_line_m == pytest.approx(2.3 - distance)
    assert (outcome.speed_at_verdict, outcome.flags) == (5.0, ())


def test_only_a_stop_before_the_junction_has_a_nose_past_the_line() -> None:
    assert judged(moves(-17.0, (1.0, 8.0), (9.0, 0.0), ON)).over_line_m is None
    inside = judged(moves(-15.0, (1.0, 8.0), (9.0, 0.0)))
    assert (inside.over_line_m, inside.stop_past_line_m) == (None, pytest.approx(1.0 + 2.3))


@pytest.mark.parametrize(
    ("legs", "expected"),
    [
        ([(3.0, 0.0)], 2.0),
        ([(2.95, 0.0)], None),
        ([(3.0, 0.29)], 2.0),
        ([(3.0, 0.31)], None),
        ([(1.0, 0.0), (1.0, 8.0), (3.0, 0.0), (1.0, 8.0), (4.0, 0.0)], 4.0),
    ],
)
def test_the_first_stop_is_told_by_its_begin(legs: list[tuple[float, float]], expected: float | None) -> None:
    outcome = judged(moves(-55.0, (2.0, 16.0), *legs, (5.0, 40.0), ON))
    assert outcome.verdict is Verdict.EXIT_COMMANDED
    assert outcome.first_stop_s == (None if expected is None else pytest.approx(expected))
