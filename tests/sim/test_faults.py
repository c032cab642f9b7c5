import asyncio
from functools import partial
from pathlib import Path

import pytest

from wrongturn_networks import draw_trial, faults, load_town
from wrongturn_protocol import Command, FaultKind, JunctionType, PracticeRequest, ProblemType, Track
from wrongturn_service.catalogue import practice_trial
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.errors import InvalidRequestError
from wrongturn_sim import Episode, FaultNotApplicableError, WrongturnSimEnv, WrongturnVectorEnv, available_faults


def delivered(episode):
    return [(row.command, row.route_command) for row in episode.trajectory.rows]


def test_a_twin_gets_the_routes_command(make_trial, drive):
    commands = delivered(drive(make_trial(fault="none")))
    assert all(command == route for command, route in commands)
    assert {route for _, route in commands} == {4, int(make_trial(fault="none").route)}


@pytest.mark.parametrize("junction_type", [kind for kind in JunctionType if kind.missing is not None])
def test_infeasible_names_the_missing_direction_in_the_window(junction_type, make_trial, drive):
    town = load_town("junctions")
    approach = next(name for name, arm in town.approaches.items() if arm.type is junction_type)
    trial = make_trial(approach, "infeasible")
    for command, route in delivered(drive(trial)):
        assert command == (4 if route == 4 else int(junction_type.missing))


def test_omission_is_lane_follow_throughout(make_trial, drive):
    commands = delivered(drive(make_trial(fault="omission")))
    assert {command for command, _ in commands} == {4}
    assert {route for _, route in commands} > {4}


def test_the_command_seen_is_the_one_that_the_next_rows_hold(make_trial):
    episode = Episode(make_trial(fault="infeasible"), Track.STATE)
    seen = [int(episode.reset()["command"][0])]
    while episode.outcome is None and len(seen) < 60:
        seen.append(int(episode.step(0.0, 0.4, 0.0).observation["command"][0]))
    rows = episode.trajectory.rows
    assert rows[0].command == seen[0]
    for k in range(1, len(rows)):
        assert rows[k].command == seen[(k - 1) // 2]
    assert Command(rows[-1].command) is not Command.LANE_FOLLOW


def test_infeasible_is_refused_where_no_direction_is_missing():
    town = load_town("junctions")
    approach = next(name for name, arm in town.approaches.items() if arm.type is JunctionType.CROSS)
    with pytest.raises(FaultNotApplicableError, match=r"^fault\.kind: infeasible needs .* has all three; take another"):
        Episode(draw_trial(town, approach, FaultKind.INFEASIBLE, 1), Track.STATE)
    with pytest.raises(FaultNotApplicableError, match="infeasible"):
        WrongturnSimEnv(town="junctions", approach=approach, fault="infeasible")
    assert FaultKind.INFEASIBLE not in faults.faults_at(town, approach)
    assert FaultKind.INFEASIBLE in faults.faults_at(town, "J1-S")


def practise(approach, fault):
    asyncio.run(
        practice_trial(PracticeRequest(town="junctions", approach=approach, fault=fault), Draws(Path("unused")))
    )


@pytest.mark.parametrize("kind", sorted(set(FaultKind) - set(available_faults())))
def test_a_fault_that_is_not_built_is_refused_as_such_everywhere(kind):
    message = f"{kind} is not built yet; take one of none, infeasible, omission"
    with pytest.raises(FaultNotApplicableError, match=message):
        Episode(draw_trial(load_town("junctions"), "J1-S", kind, 1), Track.STATE)
    for approach in (None, "J1-S"):
        for environment in (WrongturnSimEnv, partial(WrongturnVectorEnv, 2)):
            with pytest.raises(FaultNotApplicableError, match=message):
                environment(town="junctions", approach=approach, fault=kind)
    with pytest.raises(InvalidRequestError, match=message) as refused:
        practise("J1-S", kind)
    assert (refused.value.status, refused.value.kind) == (422, ProblemType.FAULT_NOT_APPLICABLE)
    assert [error.path for error in refused.value.errors] == ["fault"]
