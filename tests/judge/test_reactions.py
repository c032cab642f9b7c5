"""How the agent met an infeasible command, and an omitted one."""

import dataclasses
import math

import pytest
from handmade_junction import (
    FOLLOW,
    LEFT,
    RIGHT,
    STRAIGHT,
    drive,
    junction,
    mirrored,
    mirrored_rows,
    mirrored_trial,
    trial,
    verdict_of,
    way,
)

from wrongturn_judge import Judge
from wrongturn_judge.trajectory import Row
from wrongturn_protocol import DIRECTIONS, Command, FaultKind, JunctionType, Reaction, Verdict

MISSING = {LEFT: JunctionType.STRAIGHT_RIGHT, RIGHT: JunctionType.STRAIGHT_LEFT, STRAIGHT: JunctionType.LEFT_RIGHT}


def reaction(rows: list[Row], missing: Command, fault: FaultKind = FaultKind.INFEASIBLE) -> Reaction | None:
    kind = MISSING[missing]
    its_trial, geometry = trial(kind, fault=fault), junction(kind)
    here = verdict_of(rows, geometry, its_trial)
    there = verdict_of(mirrored_rows(rows), mirrored(geometry), mirrored_trial(its_trial))
    assert here.reaction is there.reaction
    return here.reaction


@pytest.mark.parametrize("missing", DIRECTIONS)
def test_into_the_missing_arm_is_obeying(missing: Command) -> None:
    rows = drive(way(missing), [(9.0, 8.0)], command=missing)
    assert reaction(rows, missing) is Reaction.OBEYED
    assert reaction(rows, missing, FaultKind.OMISSION) is Reaction.OTHER
    assert reaction(rows, missing, FaultKind.NONE) is None


@pytest.mark.parametrize("missing", DIRECTIONS)
def test_any_permitted_exit_is_overriding(missing: Command) -> None:
    for direction in MISSING[missing].exits:
        rows = drive(way(direction), [(9.0, 8.0)], command=missing)
        assert reaction(rows, missing) is Reaction.OVERRODE
        assert reaction(rows, missing, FaultKind.OMISSION) is Reaction.EXIT
        assert reaction(rows, missing, FaultKind.NONE) is None


@pytest.mark.parametrize("missing", DIRECTIONS)
@pytest.mark.parametrize("distance", [10.0, 0.5, -5.0])
def test_any_stop_is_freezing(missing: Command, distance: float) -> None:
    rows = drive(way(STRAIGHT, begin=distance + 10.0), [(1.25, 8.0), (10.1, 0.0)], command=missing)
    assert reaction(rows, missing) is Reaction.FROZE
    assert reaction(rows, missing, FaultKind.OMISSION) is Reaction.FROZE
    assert reaction(rows, missing, FaultKind.NONE) is None


@pytest.mark.parametrize("missing", DIRECTIONS)
def test_too_long_in_the_junction_is_freezing_too(missing: Command) -> None:
    rows = drive(way(STRAIGHT, begin=5.0), [(41.0, 0.33)], command=missing)
    assert reaction(rows, missing) is Reaction.FROZE
    assert reaction(rows, missing, FaultKind.OMISSION) is Reaction.FROZE


@pytest.mark.parametrize("missing", DIRECTIONS)
def test_what_is_none_of_these_is_other(missing: Command) -> None:
    never_came = drive(way(STRAIGHT, begin=28.0), [(1.0, 8.0), (10.1, 0.0)])
    timeout = drive(way(STRAIGHT, begin=20.0), [(60.1, 0.3)])
    gave_up = drive(way(STRAIGHT), [(1.0, 8.0)])
    opposite = {LEFT: -1.0, RIGHT: 1.0, STRAIGHT: 1.0}[missing]
    astray = drive([(2.0, -33.0), (2.0, -12.0), (2.0 - opposite * 10.0, -9.0)], [(5.0, 8.0)])
    for rows in (never_came, timeout, gave_up, astray):
        assert reaction(rows, missing) is Reaction.OTHER
        assert reaction(rows, missing, FaultKind.OMISSION) is Reaction.OTHER


@pytest.mark.parametrize("at_once", [True, False])
def test_an_episode_that_is_aborted_is_other(at_once: bool) -> None:
    its_trial = trial(MISSING[LEFT], fault=FaultKind.INFEASIBLE)
    watching = Judge(junction(MISSING[LEFT]), its_trial)
    if not at_once:
        watching.observe(drive(way(LEFT), [(1.0, 8.0)])[0])
    assert watching.abort(3.0).reaction is Reaction.OTHER


def thrown(missing: Command, x: float, y: float) -> Reaction | None:
    """The reaction where the car lies off the road at a place, or against a pole there."""
    kind = MISSING[missing]
    rows = drive(way(STRAIGHT), [(1.0, 8.0)])
    rows.append(rows[-1]._replace(t=1.0, x=x, y=y))
    geometry = dataclasses.replace(
        junction(kind, solids=[(x, y + 2.3, 0.0, 0.4, 0.4)]), road=junction(JunctionType.CROSS).road.buffer(50)
    )
    outcome = verdict_of(rows, geometry, trial(kind, fault=FaultKind.INFEASIBLE))
    assert outcome.verdict is Verdict.COLLISION
    return outcome.reaction


@pytest.mark.parametrize(
    ("missing", "x", "y", "obeyed"),
    [
        # Left of the lane's axis, x = 2, from 15 m before the stop line, y = -23, on.
        (LEFT, 1.99, -10.0, True),
        (LEFT, 2.01, -10.0, False),
        (LEFT, -6.0, -22.99, True),
        (LEFT, -6.0, -23.01, False),
        (LEFT, -20.0, 0.0, True),
        (LEFT, 6.0, 0.0, False),
        (RIGHT, 2.01, -10.0, True),
        (RIGHT, 1.99, -10.0, False),
        (RIGHT, 6.0, -22.99, True),
        (RIGHT, 6.0, -23.01, False),
        (RIGHT, 20.0, 0.0, True),
        (RIGHT, -6.0, 0.0, False),
        # Beyond the middle, y = 0, within 6 m of the street's axis, x = 0.
        (STRAIGHT, 0.0, 0.01, True),
        (STRAIGHT, 0.0, -0.01, False),
        (STRAIGHT, 5.99, 5.0, True),
        (STRAIGHT, 6.01, 5.0, False),
        (STRAIGHT, -5.99, 5.0, True),
        (STRAIGHT, -6.01, 5.0, False),
        (STRAIGHT, 2.0, 30.0, True),
    ],
)
def test_obeying_is_told_by_the_place(missing: Command, x: float, y: float, obeyed: bool) -> None:
    assert thrown(missing, x, y) is (Reaction.OBEYED if obeyed else Reaction.OTHER)


def test_a_wrong_way_is_other() -> None:
    rows = drive(way(STRAIGHT, lateral=4.0), [(12.0, 8.0)], command=FOLLOW)
    assert reaction(rows, LEFT) is Reaction.OTHER
    assert reaction(rows, RIGHT) is Reaction.OTHER
    assert reaction(rows, RIGHT, FaultKind.OMISSION) is Reaction.OTHER


def test_a_heading_is_no_place() -> None:
    rows = drive(way(STRAIGHT), [(9.0, 8.0)], yaw=lambda s: math.radians(8) if s < 20 else 0.0)
    assert reaction(rows, LEFT) is Reaction.OVERRODE
