"""Verdicts in the shipped towns, at every approach."""

import functools
import math

import numpy as np
import pytest
import shapely
from handmade_junction import Points, drive, verdict_of

from wrongturn_judge import GeometryMismatchError, Judge, JudgeGeometry, RowError, judge
from wrongturn_judge.trajectory import Trajectory
from wrongturn_networks import Approach, Town, load_town, town_names
from wrongturn_networks.errors import UnknownApproachError
from wrongturn_protocol import VEHICLE, Command, Fault, FaultKind, Flag, Reaction, Start, Trial, Verdict
from wrongturn_sim.ego import SUB_STEP

EVERY = [(name, approach) for name in town_names() for approach in load_town(name).approaches]
every_approach = pytest.mark.parametrize(("name", "approach_id"), EVERY)
BEFORE, SPEED = 18.0, 8.0


def trial_at(town: Town, approach: Approach, fault: FaultKind = FaultKind.NONE) -> Trial:
    return Trial(
        id=f"{town.name}.{approach.id}.{fault}.s0",
        town=town.name,
        approach=approach.id,
        junction_type=approach.type,
        route=next(iter(approach.exits)),
        start=Start(distance=BEFORE, speed=SPEED, lateral=0.0, yaw=0.0),
        fault=Fault(kind=fault),
        seed=0,
    )


@functools.cache
def lane_before(town: Town, approach: Approach) -> Points:
    """The lane's last metres."""
    lane = town.lanes[approach.lane]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(lane.centreline, axis=0).T))])
    begin = max(along[-1] - BEFORE, 0.5)
    x, y = (np.interp(begin, along, lane.centreline[:, k]) for k in (0, 1))
    return [(float(x), float(y)), *map(tuple, lane.centreline[along > begin + 0.1].tolist())]


def joined(*pieces: Points) -> Points:
    """One path without repeated points."""
    path: Points = []
    for x, y in (point for piece in pieces for point in piece):
        if not path or math.dist(path[-1], (x, y)) > 0.02:
            path.append((x, y))
    return path


def place(
    name: str, approach_id: str, fault: FaultKind = FaultKind.NONE
) -> tuple[Town, Approach, Trial, JudgeGeometry]:
    town = load_town(name)
    approach = town.approach(approach_id)
    trial = trial_at(town, approach, fault)
    return town, approach, trial, JudgeGeometry.of(town, trial)


@every_approach
def test_every_permitted_path_is_an_exit_without_a_flag(name: str, approach_id: str) -> None:
    town, approach, trial, geometry = place(name, approach_id)
    for direction, leaving in approach.exits.items():
        path = joined(lane_before(town, approach), leaving.path.tolist(), town.lanes[leaving.lane].centreline.tolist())
        rows = drive(path, [(11.0, SPEED)], command=direction)
        outcome = verdict_of(rows, geometry, trial)
        assert (outcome.verdict, outcome.exit) == (Verdict.EXIT_COMMANDED, direction)
        assert outcome.flags == ()


@every_approach
def test_every_stop_counts_by_its_place(name: str, approach_id: str) -> None:
    town, approach, trial, geometry = place(name, approach_id, FaultKind.INFEASIBLE)
    path = joined(lane_before(town, approach), next(iter(approach.exits.values())).path.tolist())
    start = geometry.beside_approach(*path[0])[0]
    for metres, verdict in ((-5.0, Verdict.STOPPED_BEFORE_JUNCTION), (5.0, Verdict.STOPPED_IN_JUNCTION)):
        outcome = verdict_of(drive(path, [((metres - start) / SPEED, SPEED), (10.1, 0.0)]), geometry, trial)
        assert (outcome.verdict, outcome.reaction, outcome.flags) == (verdict, Reaction.FROZE, ())


@every_approach
def test_every_missing_arm_is_obeyed_off_the_road_or_against_something(name: str, approach_id: str) -> None:
    missing = load_town(name).approach(approach_id).type.missing
    if missing is None:
        return
    town, approach, trial, geometry = place(name, approach_id, FaultKind.INFEASIBLE)
    x, y, ux, uy = geometry.stop_line
    side = {Command.LEFT: 1.0, Command.RIGHT: -1.0, Command.STRAIGHT: 0.0}[missing]
    inside = (x + 4.0 * ux, y + 4.0 * uy)
    if side:
        ahead = (inside[0] + 2.0 * ux - side * 30.0 * uy, inside[1] + 2.0 * uy + side * 30.0 * ux)
    else:
        ahead = (x + 60.0 * ux, y + 60.0 * uy)
    outcome = verdict_of(
        drive(joined(lane_before(town, approach), [inside, ahead]), [(8.0, SPEED)], command=missing), geometry, trial
    )
    assert outcome.verdict in {Verdict.OFF_ROAD, Verdict.COLLISION}
    assert outcome.reaction is Reaction.OBEYED


@every_approach
def test_every_oncoming_lane_out_is_the_wrong_way(name: str, approach_id: str) -> None:
    town, approach, trial, geometry = place(name, approach_id)
    for direction, leaving in approach.exits.items():
        opposite = town.lanes[leaving.lane].opposite
        assert opposite is not None
        out = town.lanes[opposite].centreline[::-1].tolist()
        if town.lanes[opposite].length < 25.0:
            continue
        rows = drive(joined(lane_before(town, approach), out), [(12.0, SPEED)], command=direction)
        outcome = verdict_of(rows, geometry, trial)
        # On the way across, a car that cuts the corner may leave the road.
        assert outcome.verdict in {Verdict.WRONG_WAY, Verdict.OFF_ROAD, Verdict.COLLISION}
        if outcome.verdict is Verdict.WRONG_WAY:
            assert outcome.flags == (Flag.OPPOSED_LANE,)
            assert outcome.opposed_lane_m is not None
            assert 10.0 < outcome.opposed_lane_m <= outcome.time * SPEED


@pytest.mark.parametrize("name", town_names())
def test_every_wall_and_trunk_is_a_collision(name: str) -> None:
    town = load_town(name)
    approach = next(iter(town.approaches.values()))
    trial = trial_at(town, approach)
    geometry = JudgeGeometry.of(town, trial)
    solid = [thing for thing in town.scenery if thing.solid]
    assert len(geometry.solids) == len(solid)
    start = drive(lane_before(town, approach), [(0.05, SPEED)])[0]
    footprints = np.array([thing.footprint() for thing in solid])
    for thing, footprint in zip(solid, footprints, strict=True):
        row = start._replace(t=0.05, x=thing.x, y=thing.y, yaw=thing.yaw + 0.3)
        assert verdict_of([start, row], geometry, trial).verdict is Verdict.COLLISION
        beside = footprint.buffer(2.6).boundary.interpolate(0.3, normalized=True)
        row = start._replace(t=0.05, x=beside.x, y=beside.y)
        if shapely.distance(footprints, beside).min() > 2.5:
            assert verdict_of([start, row], geometry, trial).verdict is not Verdict.COLLISION


@pytest.mark.parametrize("name", town_names())
def test_scenery_is_out_of_reach_of_a_car_on_the_road(name: str) -> None:
    """docs/verdicts.md says so: a car that hits scenery has left the road before, unless it is faster than 14 m/s."""
    town = load_town(name)
    nearest = min(thing.footprint().distance(town.road) for thing in town.scenery if thing.solid)
    assert round(nearest, 1) == 3.2
    assert (nearest - math.hypot(VEHICLE.half_length, VEHICLE.half_width)) / SUB_STEP > 14.0


def test_a_geometry_is_made_once_for_an_approach() -> None:
    town = load_town("junctions")
    first, second = (trial_at(town, approach) for approach in list(town.approaches.values())[:2])
    assert JudgeGeometry.of(town, first) is JudgeGeometry.of(town, first)
    assert JudgeGeometry.of(town, first) is not JudgeGeometry.of(town, second)
    twin = first.model_copy(update={"seed": 5})
    assert JudgeGeometry.of(town, twin) is JudgeGeometry.of(town, first)
    with pytest.raises(UnknownApproachError):
        JudgeGeometry.of(town, first.model_copy(update={"approach": "J99-S"}))


def test_what_does_not_fit_together_is_refused() -> None:
    town = load_town("junctions")
    by_type = {approach.type: approach for approach in town.approaches.values()}
    one, other = list(by_type.values())[:2]
    geometry = JudgeGeometry.of(town, trial_at(town, one))
    with pytest.raises(GeometryMismatchError, match=r"take it from JudgeGeometry\.of"):
        Judge(geometry, trial_at(town, other))
    with pytest.raises(GeometryMismatchError, match="town_sha256"):
        judge(Trajectory(trial_at(town, one), "f" * 64, []), geometry)


def test_rows_out_of_order_or_not_finite_are_refused() -> None:
    town = load_town("junctions")
    approach = next(iter(town.approaches.values()))
    rows = drive(lane_before(town, approach), [(1.0, SPEED)])
    trial = trial_at(town, approach)
    for bad, message in (
        (rows[0], "order"),
        (rows[1]._replace(x=math.nan), "finite"),
        (rows[1]._replace(v=math.inf), "finite"),
        (rows[1]._replace(t=math.nan), "order"),
    ):
        watching = Judge(JudgeGeometry.of(town, trial), trial)
        watching.observe(rows[0])
        with pytest.raises(RowError, match=message):
            watching.observe(bad)


def test_a_record_without_rows_was_aborted() -> None:
    town = load_town("junctions")
    trial = trial_at(town, next(iter(town.approaches.values())))
    outcome = judge(Trajectory(trial, town.sha256, []), JudgeGeometry.of(town, trial))
    assert (outcome.verdict, outcome.time) == (Verdict.ABORTED, 0.0)
