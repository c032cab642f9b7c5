"""Waypoints against values worked out by hand: soft-argmax, the camera's projection, and the controllers."""

import math

import pytest
import torch

from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl, mean_speed, steering_to
from wrongturn_agents.models.waypoints import APART, BEFORE, COUNT, soft_argmax, to_ground, to_picture
from wrongturn_client import TrackerGains
from wrongturn_sim.camera import Camera


def test_soft_argmax_is_the_mean_place_of_the_heat():
    # Heat 1/2 at the left, 1/4 in the middle and 1/4 at the right of the upper of two rows.
    logits = torch.log(torch.tensor([[2.0, 1.0, 1.0], [1e-30, 1e-30, 1e-30]]))
    assert soft_argmax(logits).tolist() == pytest.approx([0.5 * -1 + 0.25 * 0 + 0.25 * 1, -1.0])
    # The same everywhere: the middle.
    assert soft_argmax(torch.zeros(2, 3, 16, 48)).abs().max().item() < 1e-6
    # One hot place: row 3 of 5, column 1 of 9.
    sharp = torch.zeros(5, 9)
    sharp[3, 1] = 100.0
    assert soft_argmax(sharp).tolist() == pytest.approx([-0.75, 0.5])


def test_points_of_the_picture_are_the_cameras():
    camera = Camera()
    places = torch.tensor([[0.0, 0.0], [5.0, 1.0], [12.0, -3.0], [25.0, 0.5]])
    found = to_picture(places)
    # The camera stands 0.7 m ahead of the body's centre, and places are moved ahead by BEFORE.
    there = [(x + BEFORE + camera.forward, y, 0.0) for x, y in places.tolist()]
    pixels = camera.project(there, 0.0, 0.0, 0.0)
    wanted = [[2.0 * column / camera.width - 1.0, 2.0 * row / camera.height - 1.0] for column, row in pixels]
    assert found.tolist() == [pytest.approx(point, abs=1e-5) for point in wanted]
    assert found[0, 1].item() == pytest.approx(2.0 * 63.5 / 64 - 1.0)


def test_the_ground_is_the_inverse_of_the_picture():
    places = torch.tensor([[0.0, 0.0], [2.5, -1.0], [9.5, 6.9], [24.0, -2.0]])
    assert torch.allclose(to_ground(to_picture(places)), places, atol=1e-3)
    # A point above the horizon is far away, not behind the car.
    assert to_ground(torch.tensor([0.0, -1.0]))[0] > 100.0


def straight(speed):
    return torch.tensor([[[speed * APART * (k + 1), 0.0] for k in range(COUNT)]])


def test_the_mean_speed_begins_at_the_car():
    assert mean_speed(straight(7.0)).item() == pytest.approx(7.0)
    # 3 m to the first waypoint and none further: 3 m in 2.5 s.
    assert mean_speed(torch.tensor([[[0.0, 3.0]] * COUNT])).item() == pytest.approx(1.2)


def test_steering_leads_the_rear_axle_along_an_arc_to_the_waypoint():
    # The rear axle lies 1.45 m behind the centre. On a circle of 10 m about (-1.45, 10), a quarter turn ends here.
    assert steering_to(torch.tensor([[8.55, 10.0]])).item() == pytest.approx(-math.atan(2.9 / 10) / math.radians(35))
    assert steering_to(torch.tensor([[8.55, -10.0]])).item() > 0.0
    assert steering_to(torch.tensor([[8.0, 0.0]])).item() == 0.0


def test_controls_are_proportional_and_integral_parts_of_the_errors():
    control = WaypointControl(TrackerGains(steer=(0.9, 0.1), speed=(0.8, 0.2), aim_s=1.0, lasting_s=2.0))
    action, memory = control(straight(7.0), torch.tensor([[6.0]]), torch.tensor([[0.0, 0.5]]))
    # The mean error moves from 0.5 towards 1 by a twentieth; then 0.8 * 1 + 0.2 * 0.525 = 0.905 m/s².
    assert memory.tolist() == [pytest.approx([0.0, 0.525])]
    assert action.tolist() == [pytest.approx([0.0, 0.905 / 3.5, 0.0])]
    action, memory = control(straight(4.0), torch.tensor([[9.0]]), torch.zeros(1, MEMORY))
    # An error of -5 m/s: -4 - 0.2 * 0.25 = -4.05 m/s², by the brake alone.
    assert action.tolist() == [pytest.approx([0.0, 0.0, 4.05 / 8.0])]
    turning = straight(5.0) + torch.tensor([0.0, 1.0])
    error = steering_to(turning[:, 1]).item()
    action, memory = control(turning, torch.tensor([[5.0]]), torch.zeros(1, MEMORY))
    assert memory[0, 0].item() == pytest.approx(error / 20)
    assert action[0, 0].item() == pytest.approx(0.9 * error + 0.1 * error / 20)


def test_a_car_brakes_fully_where_its_waypoints_stand_still():
    action, _ = WaypointControl()(straight(0.2), torch.tensor([[0.0]]), torch.zeros(1, MEMORY))
    assert action.tolist() == [[0.0, 0.0, 1.0]]


def test_controls_stay_in_their_ranges():
    action, _ = WaypointControl()(straight(20.0), torch.tensor([[0.0]]), torch.zeros(1, MEMORY))
    assert action.tolist() == [[0.0, 1.0, 0.0]]
    aside = torch.tensor([[[0.5, 3.0]] * COUNT])
    assert WaypointControl()(aside, torch.tensor([[5.0]]), torch.zeros(1, MEMORY))[0][0, 0].item() == -1.0
