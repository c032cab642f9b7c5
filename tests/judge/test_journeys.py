"""The rules of journeys, on both sides of each threshold."""

import itertools
import math

import numpy as np
import pytest
from shapely import Point

from wrongturn_judge import GeometryMismatchError, JourneyGeometry, JourneyJudge, Judge, RowError
from wrongturn_networks import load_town
from wrongturn_protocol import Fault, FaultKind, Flag, Journey, Start, Task, Trial, Verdict
from wrongturn_sim import JudgeGeometry, Row, Trajectory, judge
from wrongturn_sim.polyline import Polyline, project

TOWN = load_town("Town02")
GEOMETRY = JourneyGeometry.of(TOWN)
APPROACH = max(TOWN.approaches.values(), key=lambda one: (TOWN.lanes[one.lane].length, one.id))
LANE = TOWN.lanes[APPROACH.lane]
DIRECTION, EXIT = next(iter(APPROACH.exits.items()))
GOAL = TOWN.lanes[EXIT.lane]
GOAL_AT = 15.0
STEP = 0.05


def trial(task=Task.NAVIGATION, *, time_limit=100.0, **more):
    goal = {} if task is Task.CRUISE else {"goal": GOAL.id, "goal_at": GOAL_AT, "length": 40.0}
    return Trial(
        id="a-journey",
        town=TOWN.name,
        approach=APPROACH.id,
        junction_type=APPROACH.type,
        route=DIRECTION,
        start=Start(distance=30.0, speed=0.0, lateral=0.0, yaw=0.0),
        fault=Fault(kind=FaultKind.NONE),
        seed=1,
        journey=Journey.model_validate({"task": task, "time_limit": time_limit, **goal, **more}),
    )


CRUISE = trial(Task.CRUISE)


def place(lane, s, lateral=0.0, turned=0.0):
    """x, y, yaw beside a lane's centre line, metres to the left and turned by degrees to the left."""
    path = Polyline(lane.centreline)
    (x, y), (ahead_x, ahead_y) = ([np.interp(at, path.along, path.points[:, k]) for k in (0, 1)] for at in (s, s + 0.1))
    heading = math.atan2(ahead_y - y, ahead_x - x)
    return x - lateral * math.sin(heading), y + lateral * math.cos(heading), heading + math.radians(turned)


ON_ROAD = place(LANE, LANE.length - 25.0)
BESIDE = place(LANE, LANE.length - 25.0, lateral=LANE.width)
"""In the oncoming lane."""
OFF = place(LANE, LANE.length - 25.0, lateral=-0.5 * LANE.width - 0.1)
"""The centre is off the road, and no wall is there."""


def row(t, where=ON_ROAD, v=5.0, users=()):
    return Row(t, *where, v, 0.0, 4, 4, 0.0, 0.0, 0.0, tuple(users))


def watch(its_trial, rows, *, strict=False):
    watching = JourneyJudge(GEOMETRY, its_trial, strict=strict)
    for one in rows:
        if watching.observe(one) is not None:
            break
    return watching


def timed(*pieces, v=5.0):
    """Rows 0.05 s apart: each place so many times."""
    places = [where for where, count in pieces for _ in range(count)]
    return [row(k * STEP, where, v) for k, where in enumerate(places)]


def ended(rows, *, strict=False, its_trial=CRUISE):
    outcome = watch(its_trial, rows, strict=strict).outcome
    return None if outcome is None else (outcome.verdict, round(outcome.time, 6))


def counted(rows, its_trial=CRUISE):
    """What a drive came to that did not end by itself."""
    watching = watch(its_trial, rows)
    assert watching.outcome is None
    outcome = watching.abort(rows[-1].t)
    assert outcome.verdict is Verdict.ABORTED
    return outcome


def test_a_collision_comes_first():
    x, y, yaw = OFF
    rows = [*timed((ON_ROAD, 3)), row(3 * STEP, OFF, users=[(x + 1.0, y, yaw, 4.0, 1.8, 0.0)])]
    for strict in (False, True):
        outcome = watch(CRUISE, rows, strict=strict).outcome
        assert outcome.verdict is Verdict.COLLISION
        assert outcome.journey.collisions == 1
        assert not outcome.journey.clean
        assert outcome.min_ttc == 0.0


@pytest.mark.parametrize(("where", "verdict"), [(OFF, Verdict.OFF_ROAD), (BESIDE, Verdict.WRONG_WAY)])
def test_what_ends_a_strict_drive_is_counted_otherwise(where, verdict):
    rows = timed((ON_ROAD, 3), (where, 30), (ON_ROAD, 3))
    assert ended(rows, strict=True)[0] is verdict
    journey = counted(rows).journey
    assert (journey.off_road, journey.wrong_lane) == ((1, 0) if where is OFF else (0, 1))
    assert not journey.clean


def test_off_the_road_ends_a_strict_drive_at_once():
    assert ended(timed((ON_ROAD, 3), (OFF, 1)), strict=True) == (Verdict.OFF_ROAD, 0.15)


@pytest.mark.parametrize("where", [OFF, BESIDE])
@pytest.mark.parametrize(("apart", "times"), [(19, 1), (20, 2)])
def test_it_counts_anew_after_a_second_back(where, apart, times):
    journey = counted(timed((ON_ROAD, 2), (where, 4), (ON_ROAD, apart - 1), (where, 3), (ON_ROAD, 2))).journey
    assert max(journey.off_road, journey.wrong_lane) == times


def test_a_second_in_the_oncoming_lane_is_a_wrong_way():
    assert ended(timed((ON_ROAD, 2), (BESIDE, 20), (ON_ROAD, 2)), strict=True) is None
    assert ended(timed((ON_ROAD, 2), (BESIDE, 21)), strict=True) == (Verdict.WRONG_WAY, 1.1)
    assert ended(timed((BESIDE, 15), (ON_ROAD, 1), (BESIDE, 20), (ON_ROAD, 1)), strict=True) is None
    outcome = watch(CRUISE, timed((BESIDE, 21)), strict=True).outcome
    assert outcome.flags == (Flag.LANE_INVASION, Flag.WRONG_WAY)


def test_in_a_junction_no_lane_is_oncoming():
    x, y = TOWN.junctions[APPROACH.junction].area.representative_point().coords[0]
    for yaw in np.linspace(-3.0, 3.0, 7):
        assert counted(timed(((x, y, yaw), 30))).journey.wrong_lane == 0
        assert ended(timed(((x, y, yaw), 30)), strict=True) is None


def test_five_seconds_of_standing_end_a_strict_drive():
    slow = timed((ON_ROAD, 101), v=0.29)
    assert ended(slow[:100], strict=True) is None
    assert ended(slow, strict=True) == (Verdict.NOT_ENGAGED, 5.0)
    assert ended(slow) is None
    assert ended(timed((ON_ROAD, 300), v=0.3), strict=True) is None
    moved = [one if k != 90 else one._replace(v=1.0) for k, one in enumerate(timed((ON_ROAD, 190), v=0.0))]
    assert ended(moved, strict=True) is None


def test_it_arrives_at_the_goal_by_its_lane_and_in_its_direction():
    navigation = trial()
    for where, there in {
        place(GOAL, GOAL_AT - 0.02): False,
        place(GOAL, GOAL_AT + 0.02): True,
        place(GOAL, GOAL_AT + 5.0): True,
        place(GOAL, GOAL_AT + 0.02, turned=89.0): True,
        place(GOAL, GOAL_AT + 0.02, turned=91.0): False,
        place(GOAL, GOAL_AT + 0.02, lateral=GOAL.width): False,
        place(LANE, LANE.length - 1.0): False,
    }.items():
        for strict in (False, True):
            expected = (Verdict.ARRIVED, 0.0) if there else None
            assert ended(timed((where, 1)), its_trial=navigation, strict=strict) == expected
    assert ended(timed((place(GOAL, GOAL_AT + 1.0), 1))) is None, "a cruise has no goal"


def test_time_runs_out_unless_it_arrives_with_the_same_row():
    navigation = trial(time_limit=2.0)
    rows = timed((ON_ROAD, 41))
    assert ended(rows[:40], its_trial=navigation) is None
    watching = watch(navigation, rows)
    assert watching.outcome.verdict is Verdict.TIMEOUT
    assert watching.ran_out
    late = watch(navigation, [*rows[:40], row(2.0, place(GOAL, GOAL_AT + 1.0))])
    assert late.outcome.verdict is Verdict.ARRIVED
    assert not late.ran_out


def test_distance_junctions_and_completion():
    through = Polyline(np.concatenate([LANE.centreline, EXIT.path, GOAL.centreline]))
    begin, inner = LANE.length - 30.0, Polyline(EXIT.path).length
    length = 30.0 + inner + GOAL_AT
    navigation = trial(length=length)
    at = begin + np.arange(math.ceil(length) + 2)
    path = np.column_stack([np.interp(at, through.along, through.points[:, k]) for k in (0, 1)]).tolist()
    rows = [
        row(k * STEP, (x, y, math.atan2(y2 - y, x2 - x)))
        for k, ((x, y), (x2, y2)) in enumerate(itertools.pairwise(path))
    ]
    half = counted(rows[:21], navigation).journey
    assert half.distance == pytest.approx(20.0, abs=0.01)
    assert half.completion == pytest.approx(20.0 / length, abs=1e-3)
    assert (half.junctions, half.clean) == (0, True)
    whole = watch(navigation, rows).outcome
    assert whole.verdict is Verdict.ARRIVED
    assert whole.journey.distance == pytest.approx(length, abs=1.1)
    assert (whole.journey.completion, whole.journey.junctions, whole.journey.clean) == (1.0, 1, True)
    # Who turns back keeps what was covered; who goes on past it was there.
    back = [one._replace(t=4.0 + one.t) for one in rows[:1]]
    assert counted([*rows[:21], *back], navigation).journey.completion == half.completion
    assert counted(rows, CRUISE).journey.completion == 1.0
    assert judge(Trajectory(navigation, TOWN.sha256, rows), GEOMETRY) == whole


def test_off_road_and_wrong_lane_are_what_the_polygons_say():
    """Against shapely, at places on and about the road."""
    random = np.random.default_rng(4)
    lanes = list(TOWN.lanes.values())
    seen = set()
    for _ in range(400):
        lane = lanes[random.integers(len(lanes))]
        where = place(lane, random.uniform(0.0, lane.length), random.normal(0.0, 2.5), random.uniform(-180, 180))
        x, y, yaw = where
        c, s = math.cos(yaw), math.sin(yaw)
        wheels = [(x + c * f - s * b, y + s * f + c * b) for f in (1.45, -1.45) for b in (0.8, -0.8)]
        off = sum(not TOWN.road.contains(Point(wheel)) for wheel in wheels)
        is_off = off >= 3 or not TOWN.road.contains(Point(x, y))
        inside = any(junction.area.contains(Point(x, y)) for junction in TOWN.junctions.values())
        there = [one for one in lanes if not inside and one.polygon.contains(Point(x, y))]
        lines = [Polyline(one.centreline) for one in there]
        along = [project(line.points, line.along, 0, len(line.points), x, y)[2] for line in lines]
        oncoming = any(math.cos(heading - yaw) < 0.0 for heading in along)
        outcome = watch(CRUISE, [row(0.0, where)]).abort(0.0)
        if outcome.verdict is Verdict.COLLISION:
            continue
        assert (outcome.journey.off_road, outcome.journey.wrong_lane) == (is_off, oncoming), where
        assert (Flag.KERB_BITE in outcome.flags) == (off in {1, 2} and not is_off)
        assert (ended([row(0.0, where)], strict=True) is not None) == is_off
        seen.add((is_off, oncoming, off))
    assert len(seen) > 7


def test_what_cannot_be_judged_says_why():
    with pytest.raises(GeometryMismatchError, match="is a journey"):
        Judge(JudgeGeometry.of(TOWN, CRUISE), CRUISE)
    with pytest.raises(GeometryMismatchError, match="is not a journey"):
        JourneyJudge(GEOMETRY, CRUISE.model_copy(update={"journey": None}))
    for goal in ({"goal": "nowhere"}, {"goal_at": GOAL.length + 1.0}):
        with pytest.raises(GeometryMismatchError, match=r"journey\.goal"):
            JourneyJudge(GEOMETRY, trial(**goal))
    watching = JourneyJudge(GEOMETRY, CRUISE)
    watching.observe(row(1.0))
    for wrong in (row(1.0), row(2.0, (math.nan, 0.0, 0.0))):
        with pytest.raises(RowError):
            watching.observe(wrong)
    ended_once = watching.abort(3.0)
    assert watching.observe(row(4.0)) is None
    assert watching.abort(9.0) is ended_once
