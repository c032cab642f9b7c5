import math

import numpy as np
import pytest
import torch
from small_run import settings_of

from wrongturn_agents.training.action import controls
from wrongturn_agents.training.cars import FAILURES, DrivingVecEnv, training_cars
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.world import cars_of
from wrongturn_protocol import Traffic
from wrongturn_sim import FleetTraffic

BESIDE = {"traffic": Traffic(vehicles=60, pedestrians=10), "own_traffic": FleetTraffic(hesitant=1.0, leaders=1.0)}
CRUISE = {"town": "Town01", "task": "cruise", "strict": True, "record": False}
COSTS = ("failure_penalty", "collision_penalty", "standing_penalty", "standing_cost")
FREE = {"reward_divisor": 300.0, **dict.fromkeys(COSTS, 0.0)}


def cars(count, keys=("speed",), costs=FREE, **options):
    return DrivingVecEnv(count, DrivesConfig(**FREE | costs), keys=keys, **CRUISE | options)


def by_hand(observation, i, divisor):
    """The paper's formula of what the privileged track shows of car i."""
    v = 3.6 * observation["speed"][i].item()
    target = 35.0 if observation["command"][i].item() == 4 else 15.0
    x, y, yaw = observation["pose"][i].tolist()
    (x0, y0), (x1, y1) = observation["lane"][i, :2].tolist()
    angle = math.degrees(abs(math.remainder(yaw - math.atan2(y1 - y0, x1 - x0), 2 * math.pi)))
    d = math.hypot(x - x0, y - y0)
    return ((target - abs(target - v)) + 10 * (1 - d) + 0.1 * (15 - angle)) / divisor


def test_the_reward_is_the_papers_divided():
    envs = cars(8, ("speed", "command", "pose", "lane"), track="privileged")
    envs.seed(3)
    envs.reset()
    compared = 0
    for _ in range(12):
        observation, rewards, dones, _ = envs.step(np.tile(np.float32([0.0, 0.4]), (8, 1)))
        for i in range(8):
            lane = observation["lane"][i]
            straight = (
                torch.allclose(lane[1] - lane[0], lane[3] - lane[2], atol=1e-4) and not (lane[0] == lane[1]).all()
            )
            if straight and not dones[i]:
                assert rewards[i] == pytest.approx(by_hand(observation, i, 300.0), abs=1e-4)
                compared += 1
    assert compared > 40
    envs.close()


@pytest.mark.parametrize(
    ("cost", "fails"),
    [
        ({"failure_penalty": 2.0}, lambda verdict: verdict in FAILURES),
        ({"collision_penalty": 2.0}, lambda verdict: verdict == "collision"),
        ({"standing_penalty": 2.0}, lambda verdict: verdict == "not_engaged"),
        ({"standing_cost": 0.05}, None),
    ],
)
def test_costs_are_taken_off_where_they_are_due(cost, fails):
    """The same cars with the cost and without it, beside others: half of them stop after a while, and half race ahead.

    Waiting for others is free, and other standing is not.
    """
    plain, dear = (cars(32, costs=costs, **BESIDE) for costs in (FREE, cost))
    returns, lengths, told, waited, stood = np.zeros(32), np.zeros(32), [], 0, 0
    for envs in (plain, dear):
        envs.seed(4)
        envs.reset()
    for k in range(150):
        pedals = np.float32([[0.0, 0.6 if i >= 16 else 0.3 if k < 25 else -1.0] for i in range(32)])
        (observation, first, dones, infos), (_, second, _, _) = plain.step(pedals), dear.step(pedals)
        stands = (observation["speed"][:, 0].numpy() < 0.3) & ~dones
        waits = plain.envs.waits
        if fails is None:
            wanted = np.where(stands & ~waits, 0.05, 0.0)
        else:
            wanted = np.array([2.0 if fails(info.get("verdict")) else 0.0 for info in infos])
        assert first - second == pytest.approx(wanted, abs=1e-4)
        waited, stood = waited + (stands & waits).sum(), stood + (stands & ~waits).sum()
        returns, lengths = returns + 300.0 * first, lengths + 1
        for i in np.flatnonzero(dones):
            assert infos[i]["episode"]["r"] == pytest.approx(returns[i], rel=1e-4, abs=0.05)
            assert infos[i]["episode"]["l"] == lengths[i]
            returns[i] = lengths[i] = 0
            told.append(infos[i]["verdict"])
        assert all(bool(info) == bool(done) for info, done in zip(infos, dones, strict=True))
    assert {"collision", "off_road", "not_engaged"} <= set(told)
    assert min(waited, stood) > 10
    for envs in (plain, dear):
        envs.close()


def test_what_came_last_is_given_where_time_ran_out():
    envs = cars(2, ("speed", "rgb"), track="camera", journeys={"time_limit": 0.5})
    envs.reset()
    infos = []
    for _ in range(5):
        observation, _, dones, infos = envs.step(np.zeros((2, 2), np.float32))
    assert dones.all()
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["verdict"] == "timeout"
        last = info["terminal_observation"]
        assert last["rgb"].dtype == torch.uint8
        assert not torch.equal(last["rgb"], observation["rgb"][i])  # that one is of the drive that began
    envs.close()


def test_observations_are_kept_from_being_written_over():
    envs = training_cars(2, keys=("speed", "segmentation"), track="segmentation", threads=1)
    first = envs.reset()
    before = {name: tensor.clone() for name, tensor in first.items()}
    envs.step(np.ones((2, 2), np.float32))
    assert list(first) == ["speed", "segmentation"]
    assert all(torch.equal(first[name], before[name]) for name in first)
    envs.close()


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        ((0.25, 0.5), (0.25, 0.5, 0.0)),
        ((-0.25, -0.5), (-0.25, 0.0, 0.5)),
        ((3.0, 7.0), (1.0, 1.0, 0.0)),
        ((-3.0, -7.0), (-1.0, 0.0, 1.0)),
    ],
)
def test_accelerate_is_throttle_or_brake(action, expected):
    assert controls(np.array([action, action])).tolist() == [list(expected)] * 2


def test_disturbed_cars_see_late_and_with_noise_and_steer_more_or_less():
    """Beside the same cars undisturbed, whose steering is given as the disturbed ones' turned out."""
    few = ("num_envs=8", "traffic=0", "time_limit=600", "near_junctions=0", "inside_junctions=0", "near_bends=0")
    settings = settings_of("ppo-image", *few, "noise=40", "delay=3", "steering=0.3")
    keys = ("speed", "rgb")
    plain, cars = (
        cars_of(one, "cpu", keys=keys, threads=1, seed=2) for one in (settings_of("ppo-image", *few), settings)
    )
    seen, given = [plain.reset()], [cars.reset()]
    steer = np.tile(np.float32([0.01, 0.3]), (8, 1))
    for _ in range(8):
        (found, _, ended, _) = cars.step(steer)
        given.append(found)
        seen.append(plain.step(np.column_stack([steer[:, 0] * cars._gain, steer[:, 1]]))[0])
        assert not ended.any()
    speeds, late = (torch.stack([one["speed"][:, 0] for one in some]) for some in (seen, given))
    lags = [next(lag for lag in range(4) if torch.equal(late[lag:, i], speeds[: 9 - lag, i])) for i in range(8)]
    assert len(set(lags)) > 2
    assert all(late[k, i] == speeds[0, i] for i, lag in enumerate(lags) for k in range(lag))
    off = [(given[8]["rgb"][i].float() - seen[8 - lag]["rgb"][i]).std().item() for i, lag in enumerate(lags)]
    assert min(off) < 15 < max(off) < 40
    assert len(set(cars._gain)) == 8
    assert 0.7 <= cars._gain.min() < 0.95
    assert 1.05 < cars._gain.max() <= 1.3
    plain.close()
    cars.close()


def test_cars_learn_in_many_towns_and_move_on_in_turn():
    settings = settings_of("ppo-segmentation", "num_envs=4", "sceneries=3", "groups=2", "stay=4", "traffic=0")
    cars = cars_of(settings, "cpu", track="state", keys=("speed", "command"), threads=1, seed=1)
    cars.reset()
    moved = []
    for _ in range(4):
        seen, rewards, ended, infos = cars.step(np.zeros((4, 2), np.float32))
        assert seen["speed"].shape == (4, 1)
        assert rewards.shape == (4,)
        assert ended.tolist() == [bool(info) for info in infos]
        assert all(info["TimeLimit.truncated"] and "speed" in info["terminal_observation"] for info in infos if info)
        moved.append(ended.tolist())
    cars.close()
    both = [False] * 4, [False, False, True, True], [True, True, False, False]
    assert moved == [both[0], both[1], both[0], both[2]]
