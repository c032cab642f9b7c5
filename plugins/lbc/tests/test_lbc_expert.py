"""The rule expert: it plans what a car can drive, and drives well by its own waypoints."""

import pytest
import torch

from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl
from wrongturn_agents.models.waypoints import APART, COUNT
from wrongturn_lbc.cars import Cars
from wrongturn_lbc.config import LBCConfig
from wrongturn_lbc.expert import MANNER, Situation, plan

CPU = torch.device("cpu")


def situation(path, speed, free=float("inf"), steering=0.0):
    points = torch.tensor(path, dtype=torch.float32)[None]
    return Situation(points, *(torch.tensor([value]) for value in (speed, steering, free)))


def straight():
    return [(float(k), 0.0) for k in range(60)]


def test_on_a_straight_street_the_expert_keeps_its_speed():
    waypoints = plan(situation(straight(), MANNER.cruise))[0]
    wanted = [[MANNER.cruise * APART * (k + 1), 0.0] for k in range(COUNT)]
    assert waypoints.tolist() == [pytest.approx(place, abs=0.05) for place in wanted]


def test_from_rest_it_accelerates_as_the_car_can():
    # 3.5 m/s² for 2.5 s lead 10.9 m far, less what the first step costs.
    assert plan(situation(straight(), 0.0))[0, -1, 0].item() == pytest.approx(0.5 * 3.5 * 2.5**2, abs=0.6)


def test_it_stops_where_the_way_is_no_longer_free():
    ends = plan(situation(straight(), 8.0, free=11.0))[0, :, 0]
    assert 8.0 < ends[-1].item() <= 11.5
    assert plan(situation(straight(), 0.0, free=0.0))[0].abs().max().item() < 1e-6


def test_it_returns_to_its_path_and_slows_down_for_a_turn():
    aside = [(x, -1.0) for x, _ in straight()]
    assert plan(situation(aside, 8.0))[0, -1, 1].item() == pytest.approx(-1.0, abs=0.3)
    turn = [(min(float(k), 8.0), max(0.0, k - 8.0)) for k in range(60)]
    waypoints = plan(situation(turn, 8.0))[0]
    assert waypoints[-1, 1].item() > 1.0
    assert (waypoints[-1] - waypoints[-2]).norm().item() < 0.7 * 8.0 * APART


@pytest.mark.parametrize("traffic", [0.0, 1.0])
def test_cars_that_follow_the_experts_waypoints_keep_to_their_lanes(traffic):
    config = LBCConfig(traffic=traffic, time_limit=12.0)
    cars = Cars(12, config, seed=5, pictures=False, device=CPU)
    control, memory = WaypointControl(), torch.zeros(12, MEMORY)
    speeds = []
    for _ in range(125):
        seen = cars.observe()
        action, memory = control(plan(cars.situation(seen)), seen["speed"], memory)
        memory[cars.step(action)] = 0.0
        speeds.append(seen["speed"].mean().item())
    cars.close()
    assert len(cars.ended) == 12
    assert cars.ended.count("timeout") >= 11  # traffic may end one
    assert sum(speeds) / len(speeds) > (4.0 if traffic else 7.0)


def test_the_route_is_known_before_its_command():
    cars = Cars(16, LBCConfig(near_junctions=1.0, near_bends=0.0, inside_junctions=0.0, traffic=0.0), seed=1,
                pictures=False, device=CPU)  # fmt: skip
    seen = cars.observe()
    turns = cars.situation(seen).path[:, 45]  # 45 m along the way, beyond the junction
    waits = seen["command"][:, 0] == 4
    assert waits.any()
    assert (turns[waits, 1].abs() > 8.0).any()
    cars.close()
