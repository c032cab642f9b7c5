import json

import pytest

from wrongturn_sim import Row, Trajectory, TrajectoryError


@pytest.fixture
def trajectory(make_trial):
    rows = [Row(k / 20, 1.0 + k, 0.1 * k, 0.3, 5.0, -0.1, 4, 1, 0.5, 0.25, 0.0) for k in range(3)]
    return Trajectory(make_trial(fault="infeasible"), "f" * 64, rows)


def test_json_and_back(trajectory):
    back = Trajectory.from_json(trajectory.to_json())
    assert back == trajectory
    assert back.sha256 == trajectory.sha256


def test_json_is_columns_and_the_trial_by_reference(trajectory):
    message = json.loads(trajectory.to_json())
    assert message["t"] == [0.0, 0.05, 0.1]
    assert message["route_command"] == [1, 1, 1]
    assert message["trial"] == trajectory.trial.id
    assert message["town_sha256"] == "f" * 64
    assert {"town", "approach", "fault", "seed"} <= message.keys()
    assert "road_users" not in message


def test_road_users_are_a_column_where_there_are_any(trajectory):
    other = (1.0, 2.0, 0.5, 4.3, 1.8, 7.0)
    trajectory.rows.append(trajectory.rows[0]._replace(t=0.15, road_users=(other,)))
    assert json.loads(trajectory.to_json())["road_users"] == [[], [], [], [list(other)]]
    assert Trajectory.from_json(trajectory.to_json()) == trajectory


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda m: m.pop("yaw"), "trajectory.yaw"),
        (lambda m: m.pop("town_sha256"), "trajectory.town_sha256"),
        (lambda m: m.update(x=[1.0]), "equal length"),
        (lambda m: m.update(junction_type="RING"), "junction_type"),
        (lambda m: m.update(surplus=1), "surplus"),
    ],
)
def test_a_spoilt_trajectory_is_refused_by_name(trajectory, spoil, named):
    message = json.loads(trajectory.to_json())
    spoil(message)
    with pytest.raises(TrajectoryError, match=named):
        Trajectory.from_json(json.dumps(message))


@pytest.mark.parametrize("data", [b"", b"[1]", b"\xff"])
def test_bytes_that_are_no_trajectory(data):
    with pytest.raises(TrajectoryError):
        Trajectory.from_json(data)
