import builtins
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wrongturn_networks import load_town
from wrongturn_protocol import Track, Traffic
from wrongturn_sim import (
    Episode,
    Simulator,
    SimulatorFailedError,
    SimulatorInUseError,
    SimulatorUnavailableError,
    WrongturnSimEnv,
    WrongturnVectorEnv,
)
from wrongturn_sim import simulator as bridge
from wrongturn_sim.route import start_pose
from wrongturn_sim.traffic.plan import plan_traffic


@pytest.fixture
def busy(make_trial):
    """Draw a trial with another car in town."""
    return lambda **more: make_trial(traffic=Traffic(vehicles=1), **more)


def plan_of(trial):
    town = load_town(trial.town)
    start = start_pose(town, trial)
    return town.net_file, start, plan_traffic(town, trial, start)


@pytest.mark.parametrize("shared", [None, Simulator()], ids=["each its own", "shared"])
def test_a_displaced_episode_is_told_and_can_take_the_simulator_back(busy, shared):
    first = Episode(busy(), Track.STATE, simulator=shared)
    second = Episode(busy(seed=2), Track.STATE, simulator=shared)
    first.reset()
    first.step(0.0, 0.3, 0.0)
    second.reset()
    for _ in range(2):
        with pytest.raises(SimulatorInUseError, match=r"reset this one .*WrongturnSimEnv"):
            first.step(0.0, 0.3, 0.0)
    assert first.steps == 1
    assert len(first.trajectory.rows) == 3
    second.step(0.0, 0.3, 0.0)
    first.reset()
    first.step(0.0, 0.3, 0.0)
    with pytest.raises(SimulatorInUseError):
        second.step(0.0, 0.3, 0.0)


def test_who_drives_alone_needs_no_sumo_and_disturbs_nobody(busy, make_trial, monkeypatch):
    among_others = Episode(busy(), Track.STATE)
    among_others.reset()
    monkeypatch.setattr(bridge, "load_libsumo", None)
    alone = [Episode(make_trial(seed=seed), Track.STATE) for seed in (1, 2)]
    envs = [WrongturnSimEnv("junctions"), WrongturnVectorEnv(2, "junctions", "privileged")]
    for one in (*alone, *envs):
        one.reset()
    for episode in (*alone, among_others):
        episode.step(0.0, 0.3, 0.0)
    for env in envs:
        env.step(np.zeros(env.action_space.shape, np.float32))
    assert all(episode.steps == 1 for episode in alone)


@pytest.mark.parametrize("alone", [False, True])
def test_sumo_has_the_car_where_the_episode_has_it(busy, make_trial, alone):
    episode = Episode(make_trial(seed=3) if alone else busy(seed=3), Track.STATE, mirrored=alone)
    episode.reset()
    sumo = bridge.load_libsumo()
    for k in range(25):
        episode.step(0.1 * (-1) ** (k // 4), 0.5, 0.0)
        row = episode.trajectory.rows[-1]
        x, y = sumo.vehicle.getPosition(bridge.EGO)
        assert (x - row.x, y - row.y) == pytest.approx((2.3 * math.cos(row.yaw), 2.3 * math.sin(row.yaw)), abs=1e-6)
        angle = math.radians(90.0 - sumo.vehicle.getAngle(bridge.EGO))
        assert math.remainder(angle - row.yaw, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_a_net_that_is_none_is_refused_and_the_next_one_loads(tmp_path, busy):
    broken = tmp_path / "broken.net.xml"
    broken.write_text("<net", encoding="ascii")
    good, start, plan = plan_of(busy())
    for net in (broken, Path("missing.net.xml")):
        with pytest.raises(SimulatorFailedError, match=net.name):
            Simulator().begin(net, *start, plan, seed=1)
    with pytest.raises(SimulatorFailedError, match="no-such-edge"):
        Simulator().begin(good, *start, replace(plan, ego=("no-such-edge",)), seed=1)
    episode = Episode(busy(), Track.STATE)
    episode.reset()
    episode.step(0.0, 0.0, 0.0)


def test_missing_system_libraries_are_named(monkeypatch):
    imports = builtins.__import__

    def fail(name, *rest):
        if name == "libsumo":
            raise ImportError("libXext.so.6: cannot open shared object file: No such file or directory")
        return imports(name, *rest)

    monkeypatch.setattr(bridge._Process, "sumo", None)
    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(SimulatorUnavailableError, match=r"libXext.*libx11-6 libxext6 libxrender1 libgl1 libatomic1"):
        bridge.load_libsumo()
