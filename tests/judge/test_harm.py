"""Off the road, into something, into the wrong lane; how near it came; and which verdict comes first."""

import dataclasses
import math

import pytest
from handmade_junction import FOLLOW, RIGHT, STRAIGHT, drive, junction, trial, verdict_of, way
from shapely import Point, box
from shapely.affinity import rotate, translate

from wrongturn_judge import Judge, JudgeGeometry
from wrongturn_judge.trajectory import RoadUser, Row
from wrongturn_protocol import Outcome, Verdict

CROSS = junction()
HALF_LENGTH, HALF_WIDTH, AXLE, SIDE = 2.3, 0.95, 1.45, 0.8


def place(x: float, y: float, yaw: float = math.pi / 2, v: float = 5.0, users: tuple[RoadUser, ...] = ()) -> list[Row]:
    """One row, and one before it far from everything."""
    first = Row(0.0, 2.0, -70.0, math.pi / 2, v, 0.0, int(FOLLOW), int(FOLLOW), 0.0, 0.0, 0.0)
    return [first, first._replace(t=0.05, x=x, y=y, yaw=yaw, road_users=users)]


def outcome_at(geometry: JudgeGeometry, *where: float, users: tuple[RoadUser, ...] = ()) -> Outcome:
    return verdict_of(place(*where, users=users), geometry, trial())


def only_road(*pieces: object) -> JudgeGeometry:
    """The junction with another road, which the first row's place belongs to."""
    road = box(0, -75, 4, -60)
    for piece in pieces:
        road = road.union(piece)
    return dataclasses.replace(CROSS, road=road)


# Off the road.


@pytest.mark.parametrize(
    ("lateral", "bitten", "verdict"),
    [
        (0.0, False, Verdict.EXIT_COMMANDED),
        (-1.19, False, Verdict.EXIT_COMMANDED),  # right wheels at 3.99 of 4
        (-1.21, True, Verdict.EXIT_COMMANDED),  # both right wheels off
        (-1.99, True, Verdict.EXIT_COMMANDED),  # the centre just on it
        (-2.01, False, Verdict.OFF_ROAD),  # the centre off, two wheels still on
        (-3.0, False, Verdict.OFF_ROAD),
    ],
)
def test_beside_the_lane_the_kerb_is_bitten_then_crossed(lateral: float, bitten: bool, verdict: Verdict) -> None:
    outcome = verdict_of(drive(way(STRAIGHT, lateral=lateral), [(9.0, 8.0)], command=STRAIGHT), CROSS, trial())
    assert outcome.verdict is verdict
    assert outcome.kerb_bite_m is not None
    assert (outcome.kerb_bite_m > 0.0) is bitten


CORNERS = {(forward, left): (2.0 - left, -20.0 + forward) for forward in (AXLE, -AXLE) for left in (SIDE, -SIDE)}
"""The wheels of a car at (2, -20) that heads north."""


@pytest.mark.parametrize("gone", range(16))
def test_three_wheels_off_are_off_the_road_and_one_or_two_a_kerb_bite(gone: int) -> None:
    pads = [Point(x, y).buffer(0.1) for k, (x, y) in enumerate(CORNERS.values()) if not gone >> k & 1]
    outcome = outcome_at(only_road(Point(2.0, -20.0).buffer(0.3), *pads), 2.0, -20.0)
    off = gone.bit_count()
    assert outcome.verdict is (Verdict.OFF_ROAD if off >= 3 else Verdict.ABORTED)
    assert (outcome.kerb_bite_s == 0.05) is (off in {1, 2})


@pytest.mark.parametrize("off", [0.01, 0.1, 0.3])
def test_the_centre_alone_decides_too(off: float) -> None:
    pads = [Point(x, y).buffer(0.1) for x, y in CORNERS.values()]
    assert outcome_at(only_road(box(1, -20 + off, 3, -19.5), *pads), 2.0, -20.0).verdict is Verdict.OFF_ROAD
    assert outcome_at(only_road(box(1, -20 - off, 3, -19.5), *pads), 2.0, -20.0).verdict is Verdict.ABORTED


@pytest.mark.parametrize("slip", [0.01, -0.01])
@pytest.mark.parametrize("degrees", [0, 37, 90, 200])
def test_the_wheels_turn_with_the_car(slip: float, degrees: float) -> None:
    # A pad that just holds the four wheels, or is a centimetre short at the front.
    pad = box(-AXLE - 0.5, -SIDE - 0.5, AXLE + slip, SIDE + 0.5)
    pad = translate(rotate(pad, degrees, origin=(0, 0)), 2.0, -20.0)
    outcome = outcome_at(only_road(pad), 2.0, -20.0, math.radians(degrees))
    assert (outcome.kerb_bite_s == 0.05) is (slip < 0)


def test_far_outside_the_town_is_off_the_road() -> None:
    for x, y in ((1e6, 0.0), (0.0, -1e6), (1e300, 1e300)):
        assert outcome_at(CROSS, x, y).verdict is Verdict.OFF_ROAD


# Into something.


def beside(yaw: float, box_yaw: float, gap: float) -> tuple[float, float, float, float, float]:
    """A 2 x 2 box whose nearest side or corner stands ``gap`` off the right side of a car at (2, -20)."""
    reach = abs(math.cos(box_yaw - yaw)) + abs(math.sin(box_yaw - yaw))
    distance = HALF_WIDTH + reach + gap
    return 2.0 + distance * math.sin(yaw), -20.0 - distance * math.cos(yaw), box_yaw, 2.0, 2.0


def ahead(yaw: float, box_yaw: float, gap: float) -> tuple[float, float, float, float, float]:
    """The same before its nose."""
    reach = abs(math.cos(box_yaw - yaw)) + abs(math.sin(box_yaw - yaw))
    distance = HALF_LENGTH + reach + gap
    return 2.0 + distance * math.cos(yaw), -20.0 + distance * math.sin(yaw), box_yaw, 2.0, 2.0


@pytest.mark.parametrize("shape", [beside, ahead])
@pytest.mark.parametrize("yaw", [math.pi / 2, 0.3])
@pytest.mark.parametrize("box_yaw", [0.0, math.pi / 4, 1.0])
@pytest.mark.parametrize(("gap", "hit"), [(0.01, False), (1e-6, False), (-1e-6, True), (-0.01, True), (-1.0, True)])
def test_a_box_is_hit_when_it_overlaps(shape: object, yaw: float, box_yaw: float, gap: float, hit: bool) -> None:
    assert callable(shape)
    solid = shape(yaw, box_yaw, gap)
    geometry = dataclasses.replace(CROSS, road=box(-100, -100, 100, 100), solids=junction(solids=[solid]).solids)
    expected = Verdict.COLLISION if hit else Verdict.ABORTED
    assert outcome_at(geometry, 2.0, -20.0, yaw).verdict is expected
    clear = dataclasses.replace(geometry, solids=geometry.solids[:0])
    assert outcome_at(clear, 2.0, -20.0, yaw).verdict is Verdict.ABORTED
    assert outcome_at(clear, 2.0, -20.0, yaw, users=((*solid, 0.0),)).verdict is expected


@pytest.mark.parametrize("length", [2.0, 30.0, 100.0])
def test_long_walls_are_hit_anywhere_along_them(length: float) -> None:
    for along in (-0.49, -0.2, 0.0, 0.3, 0.49):
        solid = (4.5, -20.0 + along * length, math.pi / 2, length, 0.3)
        assert outcome_at(junction(solids=[solid]), 3.0, -20.0).verdict is Verdict.ABORTED
        assert outcome_at(junction(solids=[solid]), 3.45, -20.0).verdict is Verdict.COLLISION


# How near.


def ttc_at(*users: RoadUser, v: float = 5.0) -> float | None:
    first = Row(0.0, 2.0, -40.0, math.pi / 2, v, 0.0, int(FOLLOW), int(FOLLOW), 0.0, 0.0, 0.0, users)
    return verdict_of([first], CROSS, trial()).min_ttc


@pytest.mark.parametrize("v", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("seconds", [0.1, 1.0, 4.99])
def test_time_to_collision_with_what_stands_ahead(v: float, seconds: float) -> None:
    gap = v * seconds
    y = -40.0 + HALF_LENGTH + gap + 1.0
    assert ttc_at((2.0, y, 0.0, 2.0, 2.0, 0.0), v=v) == pytest.approx(seconds)
    rows = [Row(0.0, 2.0, -40.0, math.pi / 2, v, 0.0, 4, 4, 0.0, 0.0, 0.0)]
    solid = junction(solids=[(2.0, y, 0.0, 2.0, 2.0), (2.0, y + 3.0, 0.0, 2.0, 2.0), (5.0, -40.0, 0.0, 2.0, 2.0)])
    assert verdict_of(rows, solid, trial()).min_ttc == pytest.approx(seconds)


def test_time_to_collision_with_what_moves() -> None:
    y = -40.0 + HALF_LENGTH + 20.0 + 2.3
    car = (4.6, 1.9)
    assert ttc_at((2.0, y, -math.pi / 2, *car, 5.0)) == pytest.approx(2.0)  # oncoming
    assert ttc_at((2.0, y, math.pi / 2, *car, 1.0), v=6.0) == pytest.approx(4.0)  # slower
    assert ttc_at((2.0, y, math.pi / 2, *car, 5.0)) is None  # as fast
    assert ttc_at((2.0, y, math.pi / 2, *car, 9.0)) is None  # faster
    assert ttc_at((2.0, y, -math.pi / 2, *car, 0.0), v=0.0) is None  # both stand


def test_time_to_collision_forgets_what_is_not_in_the_way() -> None:
    assert ttc_at((5.0, -20.0, 0.0, 2.0, 2.0, 0.0)) is None  # beside the way
    assert ttc_at((2.0, -60.0, 0.0, 2.0, 2.0, 0.0)) is None  # behind
    assert ttc_at((2.0, -40.0 + HALF_LENGTH + 1.0 + 5.0 * 5.01, 0.0, 2.0, 2.0, 0.0)) is None  # beyond the horizon
    assert ttc_at((2.0 + 1.95 - 0.01, -30.0, 0.0, 2.0, 2.0, 0.0)) is not None
    assert ttc_at((2.0 + 1.95 + 0.01, -30.0, 0.0, 2.0, 2.0, 0.0)) is None


def test_the_least_time_to_collision_of_the_drive_is_kept() -> None:
    def users(t: float) -> tuple[RoadUser, ...]:
        return ((2.0, -2.0, 0.0, 2.0, 2.0, 0.0),) if t < 2.0 else ()

    rows = drive(way(STRAIGHT), [(9.0, 8.0)], command=STRAIGHT, users=users)
    nearest = rows[39]
    expected = (-3.0 - (nearest.y + HALF_LENGTH)) / 8.0
    assert verdict_of(rows, CROSS, trial()).min_ttc == pytest.approx(expected)


@pytest.mark.parametrize("drop", [0.0, 0.1, 0.4])
def test_the_hardest_deceleration_is_kept(drop: float) -> None:
    rows = drive(way(STRAIGHT), [(1.0, 8.0), (0.05, 8.0 - drop), (0.05, 9.0), (9.0, 8.95)], command=STRAIGHT)
    assert verdict_of(rows, CROSS, trial()).max_deceleration == pytest.approx(max(drop, 0.05) / 0.05)


# Which comes first.


def test_at_one_instant_a_collision_comes_before_all() -> None:
    solid = junction(solids=[(6.0, -20.0, 0.0, 2.0, 2.0)])
    assert outcome_at(solid, 5.0, -20.0).verdict is Verdict.COLLISION
    wall = junction(solids=[(2.0, 40.0, 0.0, 4.0, 2.84)])
    rows = drive(way(STRAIGHT), [(9.0, 8.0)], command=STRAIGHT)
    reached = verdict_of(rows, CROSS, trial())
    hit = verdict_of(rows, wall, trial())
    assert (reached.verdict, hit.verdict) == (Verdict.EXIT_COMMANDED, Verdict.COLLISION)
    assert reached.time == hit.time


def test_at_one_instant_off_the_road_comes_before_a_stop_and_the_wrong_way() -> None:
    rows = drive(way(STRAIGHT, begin=10.0), [(1.0, 2.0), (10.05, 0.0)])
    stopped = verdict_of(rows, CROSS, trial())
    assert stopped.verdict is Verdict.STOPPED_BEFORE_JUNCTION
    k = round(stopped.time / 0.05)
    rows[k] = rows[k]._replace(x=5.0)
    assert verdict_of(rows, CROSS, trial()).verdict is Verdict.OFF_ROAD
    rows = drive(way(STRAIGHT, lateral=4.0), [(12.0, 8.0)])
    wrong = verdict_of(rows, CROSS, trial())
    assert wrong.verdict is Verdict.WRONG_WAY
    k = round(wrong.time / 0.05)
    rows[k] = rows[k]._replace(x=-5.0)
    off = verdict_of(rows, CROSS, trial())
    assert (off.verdict, off.time) == (Verdict.OFF_ROAD, wrong.time)


def test_a_verdict_may_fall_at_the_start() -> None:
    rows = [row._replace(x=5.0) for row in drive(way(RIGHT), [(1.0, 8.0)])]
    watching = Judge(CROSS, trial())
    outcome = watching.observe(rows[0])
    assert outcome is not None
    assert (outcome.verdict, outcome.time) == (Verdict.OFF_ROAD, 0.0)
    assert watching.observe(rows[1]) is None
