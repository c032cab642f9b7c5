"""The bird's-eye view shows each thing in its plane, at its place, whatever the car's pose."""

import math

import pytest
import torch

from wrongturn_agents.models.birdview import AHEAD, ASIDE, CELL, PIXELS, PLANES, birdview
from wrongturn_agents.models.lbc import COMMANDS, PrivilegedAgent, commanded
from wrongturn_protocol import Command

LANE, LEFT, RIGHT, STRAIGHT, STOP, VEHICLES, PEDESTRIANS = range(PLANES)
USERS = 32


def pixel(ahead, left):
    return round((AHEAD - ahead) / CELL), round((ASIDE - left) / CELL)


def scene(pose, *, stop_line=12.0, users=()):
    """A street to the east with a junction: exits to the left and straight on, seen from a pose."""
    lane = torch.tensor([[min(float(k), 12.0), 0.0] for k in range(60)])
    exits = torch.zeros(3, 60, 2)
    exits[0] = torch.tensor([[12.0, float(k)] for k in range(60)])
    exits[2] = torch.tensor([[12.0 + k, 0.0] for k in range(60)])
    road_users = torch.zeros(USERS, 6)
    for k, user in enumerate(users):
        road_users[k] = torch.tensor(user)
    return {
        "pose": torch.tensor([pose], dtype=torch.float64),
        "lane": lane[None],
        "stop_line": torch.tensor([[stop_line]]),
        "exits": exits[None],
        "exits_mask": torch.tensor([[1, 0, 1]], dtype=torch.int8),
        "road_users": road_users[None],
        "road_users_count": torch.tensor([[len(users)]]),
    }


def test_lane_exits_and_stop_line_have_planes_of_their_own():
    view = birdview(scene((0.0, 0.0, 0.0)))[0]
    assert view.shape == (PLANES, PIXELS, PIXELS)
    assert view[(LANE, *pixel(6, 0))] == 1.0
    assert view[(LANE, *pixel(6, 4))] < 0.01
    assert view[(LANE, *pixel(20, 0))] < 0.01
    assert view[(LEFT, *pixel(12, 8))] == 1.0
    assert view[(STRAIGHT, *pixel(25, 0))] == 1.0
    assert view[RIGHT].max() == 0.0
    assert view[(STOP, *pixel(12, 0))] > 0.9
    # The lane's last point is repeated, and counts once.
    assert view[(LANE, *pixel(14.5, 0))] < 0.01


def test_without_a_stop_line_its_plane_is_empty():
    assert birdview(scene((0.0, 0.0, 0.0), stop_line=-1.0))[0, STOP].max() == 0.0


def test_the_view_turns_with_the_car():
    # The car looks north from the middle of the street, so the street's end lies to its right.
    view = birdview(scene((4.0, 0.0, math.pi / 2)))[0]
    assert view[(LANE, *pixel(0, -6))] == 1.0
    assert view[(LANE, *pixel(6, 0))] < 0.01


def test_vehicles_and_pedestrians_are_told_apart_and_move():
    car, walker = (20.0, 3.0, math.pi, 4.5, 1.8, 8.0), (10.0, -5.0, 0.0, 0.5, 0.5, 0.0)
    view = birdview(scene((0.0, 0.0, 0.0), users=(car, walker)))[0]
    assert view[(VEHICLES, *pixel(20, 3))] == 1.0
    assert view[(VEHICLES, *pixel(20, -3))] < 0.01
    assert view[(VEHICLES, *pixel(12, 3))] > 0.4  # where it will be in a second
    assert view[(PEDESTRIANS, *pixel(10, -5))] > 0.9
    assert view[(PEDESTRIANS, *pixel(20, 3))] < 0.01
    nobody = birdview(scene((0.0, 0.0, 0.0)))[0]
    assert nobody[VEHICLES:].max() == 0.0


def test_points_of_the_privileged_agents_heat_maps_are_places_of_its_view():
    agent = PrivilegedAgent(width=8)
    corners = agent.place(torch.tensor([[-1.0, -1.0], [1.0, 1.0]])).tolist()
    assert corners == [pytest.approx([AHEAD, ASIDE]), pytest.approx([AHEAD - (PIXELS - 1) * CELL, -ASIDE])]


def test_the_commanded_waypoints_are_chosen_and_void_follows_the_lane():
    waypoints = torch.arange(4.0).view(1, 4, 1, 1).expand(6, -1, 5, 2)
    commands = torch.tensor([[1], [2], [3], [4], [-1], [0]])
    assert commanded(waypoints, commands)[:, 0, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 3.0, 3.0]
    assert COMMANDS == (Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW)
