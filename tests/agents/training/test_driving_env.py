import math

import numpy as np
import pytest
import torch

from wrongturn_agents.training.driving_env import FAILURES, DrivingVecEnv
from wrongturn_protocol import Traffic
from wrongturn_sim import FleetTraffic

BESIDE = {"traffic": Traffic(vehicles=60, pedestrians=10), "own_traffic": FleetTraffic(hesitant=1.0, leaders=1.0)}
CRUISE = {"town": "Town01", "task": "cruise", "strict": True, "record": False}
KEYS = ("speed", "command", "pose", "lane")


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
    envs = DrivingVecEnv(8, keys=KEYS, track="privileged", reward_divisor=300.0, **CRUISE)
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


def test_failures_are_penalised_and_told():
    plain, strict = (
        DrivingVecEnv(8, keys=("speed",), failure_penalty=penalty, reward_divisor=300.0, **CRUISE)
        for penalty in (0.0, 2.0)
    )
    told, returns, lengths = [], np.zeros(8), np.zeros(8)
    for envs in (plain, strict):
        envs.seed(5)
        envs.reset()
    actions = np.tile(np.float32([0.6, 0.8]), (8, 1))
    for _ in range(60):
        _, first, _, _ = plain.step(actions)
        _, second, dones, infos = strict.step(actions)
        failed = np.array([info.get("verdict") in FAILURES for info in infos])
        assert first - second == pytest.approx(np.where(failed, 2.0, 0.0), abs=1e-5)
        returns, lengths = returns + 300.0 * first, lengths + 1
        for i in np.flatnonzero(dones):
            assert infos[i]["episode"]["r"] == pytest.approx(returns[i], rel=1e-4, abs=0.05)
            assert infos[i]["episode"]["l"] == lengths[i]
            returns[i] = lengths[i] = 0
            told.append(infos[i]["verdict"])
        assert all(bool(info) == bool(done) for info, done in zip(infos, dones, strict=True))
    assert "off_road" in told
    for envs in (plain, strict):
        envs.close()


def test_a_car_that_stands_is_penalised():
    envs = DrivingVecEnv(2, keys=("speed",), standing_penalty=2.0, reward_divisor=300.0, **CRUISE)
    envs.reset()
    verdicts = []
    for _ in range(140):
        _, rewards, _, infos = envs.step(np.tile(np.float32([0.0, -1.0]), (2, 1)))
        verdicts += [(info["verdict"], reward < -1.0) for info, reward in zip(infos, rewards, strict=True) if info]
    assert ("not_engaged", True) in verdicts
    envs.close()


def test_what_came_last_is_given_where_time_ran_out():
    envs = DrivingVecEnv(2, keys=("speed", "rgb"), track="camera", journeys={"time_limit": 0.5}, **CRUISE)
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
    envs = DrivingVecEnv(2, keys=("speed", "segmentation"), track="segmentation", **CRUISE)
    first = envs.reset()
    before = {name: tensor.clone() for name, tensor in first.items()}
    envs.step(np.ones((2, 2), np.float32))
    assert list(first) == ["speed", "segmentation"]
    assert all(torch.equal(first[name], before[name]) for name in first)
    envs.close()


def test_standing_costs_at_once():
    plain, dear = (
        DrivingVecEnv(4, keys=("speed",), standing_cost=cost, reward_divisor=300.0, **CRUISE) for cost in (0.0, 0.05)
    )
    stood = 0
    for envs in (plain, dear):
        envs.seed(2)
        envs.reset()
    for _ in range(30):
        brake = np.tile(np.float32([0.0, -0.5]), (4, 1))
        (observation, first, dones, _), (_, second, _, _) = plain.step(brake), dear.step(brake)
        stands = (observation["speed"][:, 0].numpy() < 0.3) & ~dones
        assert first - second == pytest.approx(np.where(stands, 0.05, 0.0), abs=1e-6)
        stood += stands.sum()
    assert stood > 20
    for envs in (plain, dear):
        envs.close()


def test_waiting_for_others_is_free_and_other_standing_is_not():
    plain, dear = (DrivingVecEnv(16, keys=("speed",), standing_cost=cost, **BESIDE, **CRUISE) for cost in (0.0, 0.05))
    waited = stood = 0
    for envs in (plain, dear):
        envs.seed(4)
        envs.reset()
    for k in range(150):
        pedals = np.tile(np.float32([0.0, 0.3 if k < 25 else -1.0]), (16, 1))
        (observation, first, dones, _), (_, second, _, _) = plain.step(pedals), dear.step(pedals)
        stands = (observation["speed"][:, 0].numpy() < 0.3) & ~dones
        waits = plain.envs.waits
        assert first - second == pytest.approx(np.where(stands & ~waits, 0.05, 0.0), abs=1e-4)
        waited += (stands & waits).sum()
        stood += (stands & ~waits).sum()
    assert waited > 10
    assert stood > 20
    for envs in (plain, dear):
        envs.close()


def test_a_collision_costs_more_than_other_failures():
    plain, dear = (
        DrivingVecEnv(16, keys=("speed",), failure_penalty=0.5, collision_penalty=cost, **BESIDE, **CRUISE)
        for cost in (0.0, 2.0)
    )
    told = []
    for envs in (plain, dear):
        envs.seed(6)
        envs.reset()
    for _ in range(120):
        pedals = np.tile(np.float32([0.0, 0.6]), (16, 1))
        (_, first, _, _), (_, second, _, infos) = plain.step(pedals), dear.step(pedals)
        crashed = np.array([info.get("verdict") == "collision" for info in infos])
        assert first - second == pytest.approx(np.where(crashed, 2.0, 0.0), abs=1e-4)
        told += [info["verdict"] for info in infos if info]
    assert told.count("collision") > 5
    assert told.count("off_road") > 5
    for envs in (plain, dear):
        envs.close()
