import pytest

from wrongturn_networks import load_town
from wrongturn_protocol import Command, Fault, FaultKind, JunctionType, Track
from wrongturn_sim import Episode, FaultNotApplicableError, available_faults
from wrongturn_sim.faults import make_fault


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


def test_a_crossing_misses_no_direction(make_trial):
    town = load_town("junctions")
    approach = next(name for name, arm in town.approaches.items() if arm.type is JunctionType.CROSS)
    trial = make_trial(approach).model_copy(update={"fault": Fault(kind=FaultKind.INFEASIBLE)})
    with pytest.raises(FaultNotApplicableError, match="all three"):
        Episode(trial, Track.STATE)


def test_faults_to_come_are_refused_and_those_there_are_named(make_trial):
    assert set(available_faults()) >= {FaultKind.NONE, FaultKind.INFEASIBLE, FaultKind.OMISSION}
    for kind in set(FaultKind) - set(available_faults()):
        trial = make_trial().model_copy(update={"fault": Fault(kind=kind)})
        with pytest.raises(FaultNotApplicableError, match="none, infeasible, omission"):
            make_fault(trial)
