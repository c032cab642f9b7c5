"""Trajectories become controls by the published controllers, as by hand and as in the shipped agent."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl
from wrongturn_client import Tracker, TrackerGains
from wrongturn_protocol.vehicle import VEHICLE

TIMES = (0.5, 1.0, 1.5, 2.0, 2.5)
AHEAD = [[2.5 * k, 0.0] for k in range(1, 6)]


def test_straight_ahead_by_hand():
    """5 m/s wanted, 4 m/s driven: an error of 1 m/s; its mean is 0.1 / 2 of it after one decision."""
    action = Tracker(TIMES).controls(AHEAD, 4.0)
    assert action.steer == pytest.approx(0.0)
    assert action.throttle == pytest.approx((0.8 + 0.2 * 0.05) / VEHICLE.acceleration)
    assert action.brake == 0.0
    slower = Tracker(TIMES).controls(AHEAD, 6.0)
    assert (slower.throttle, slower.brake) == (0.0, pytest.approx(0.81 / VEHICLE.braking))


def test_a_curve_by_hand():
    """The aim is 4 m ahead and 1 m left: from the rear axle 5.45 and 1, so 2 / (5.45² + 1) of curvature."""
    points = [[2.0, 0.3], [4.0, 1.0], [6.0, 2.0], [7.5, 3.5], [8.0, 5.0]]
    wanted = -math.atan(VEHICLE.wheelbase * 2.0 / (5.45**2 + 1.0)) / VEHICLE.max_wheel_angle
    assert Tracker(TIMES).controls(points, 4.0).steer == pytest.approx(wanted * (0.9 + 0.1 * 0.05))
    mirrored = [[x, -y] for x, y in points]
    assert Tracker(TIMES, side="right").controls(mirrored, 4.0) == Tracker(TIMES).controls(points, 4.0)
    from_axle = [[x + 1.45, y] for x, y in points]
    moved = Tracker(TIMES, behind=1.45).controls(from_axle, 4.0)
    assert moved.steer == pytest.approx(Tracker(TIMES).controls(points, 4.0).steer)


def test_a_trajectory_that_stays_here_brakes_fully():
    action = Tracker(TIMES).controls(np.zeros((5, 2)), 3.0)
    assert (action.throttle, action.brake) == (0.0, 1.0)


def test_the_aim_lies_between_waypoints():
    coarse = Tracker([2.0], gains=TrackerGains(aim_s=1.0)).controls([[8.0, 2.0]], 4.0)
    fine = Tracker([1.0, 2.0]).controls([[4.0, 1.0], [8.0, 2.0]], 4.0)
    assert coarse.steer == pytest.approx(fine.steer)


@given(st.lists(st.tuples(st.floats(0, 6), st.floats(-3, 3)), min_size=5, max_size=5), st.floats(0, 15))
def test_it_drives_as_the_shipped_agent(steps: list[tuple[float, float]], speed: float):
    torch = pytest.importorskip("torch")
    waypoints = np.cumsum(steps, axis=0)
    tracker, control, memory = Tracker(TIMES), WaypointControl(), torch.zeros(1, MEMORY)
    for _ in range(3):
        action = tracker.controls(waypoints, speed)
        theirs, memory = control(torch.tensor(waypoints[None]), torch.tensor([[speed]]), memory)
        assert [action.steer, action.throttle, action.brake] == pytest.approx(theirs[0].tolist(), abs=1e-5)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: Tracker([]), "times: are []"),
        (lambda: Tracker([0.5, 0.5]), "times: are [0.5, 0.5]; give growing seconds"),
        (lambda: Tracker([0.5, math.nan]), "times: are"),
        (lambda: Tracker(TIMES, side="up"), "side: is 'up'; give 'left' or 'right'"),
        (lambda: Tracker(TIMES).controls(AHEAD[:4], 1.0), "waypoints: have the shape (4, 2); give (5, 2)"),
        (lambda: Tracker(TIMES).controls([[math.inf, 0.0]] * 5, 1.0), "waypoints: are not finite"),
    ],
)
def test_a_wrong_argument_is_named(call, named: str):
    with pytest.raises(ValueError, match=re.escape(named)):
        call()
