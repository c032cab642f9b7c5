import builtins
import math
from pathlib import Path

import pytest

from wrongturn_networks import load_town
from wrongturn_protocol import Track
from wrongturn_sim import Episode, Simulator, SimulatorFailedError, SimulatorInUseError, SimulatorUnavailableError
from wrongturn_sim import simulator as bridge


def test_a_displaced_environment_is_told_and_can_take_the_simulator_back(make_trial):
    first, second = Episode(make_trial(), Track.STATE), Episode(make_trial(town="Town01"), Track.STATE)
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


def test_two_episodes_that_share_a_simulator_displace_each_other_too(make_trial):
    simulator = Simulator()
    first = Episode(make_trial(), Track.STATE, simulator=simulator)
    second = Episode(make_trial(seed=2), Track.STATE, simulator=simulator)
    first.reset()
    second.reset()
    with pytest.raises(SimulatorInUseError):
        first.step(0.0, 0.0, 0.0)


def test_sumo_has_the_car_where_the_episode_has_it(make_trial):
    episode = Episode(make_trial(seed=3), Track.STATE)
    episode.reset()
    sumo = bridge.load_libsumo()
    for k in range(25):
        episode.step(0.1 * (-1) ** (k // 4), 0.5, 0.0)
        row = episode.trajectory.rows[-1]
        x, y = sumo.vehicle.getPosition(bridge.EGO)
        assert (x - row.x, y - row.y) == pytest.approx((2.3 * math.cos(row.yaw), 2.3 * math.sin(row.yaw)), abs=1e-6)
        angle = math.radians(90.0 - sumo.vehicle.getAngle(bridge.EGO))
        assert math.remainder(angle - row.yaw, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_the_car_may_go_where_no_road_is(make_trial):
    town = load_town("junctions")
    lane = town.lanes[town.approach(min(town.approaches)).lane]
    drive = Simulator().begin(town.net_file, lane.edge, 0.0, 0.0, 0.0, seed=1)
    for k in range(40):
        drive.move(-500.0 + 50.0 * k, 900.0 - 30.0 * k, 0.1 * k)
    assert drive.road_users() == ()


def test_a_net_that_is_none_is_refused_and_the_next_one_loads(tmp_path, make_trial):
    broken = tmp_path / "broken.net.xml"
    broken.write_text("<net", encoding="ascii")
    for net in (broken, Path("missing.net.xml")):
        with pytest.raises(SimulatorFailedError, match=net.name):
            Simulator().begin(net, "edge", 0.0, 0.0, 0.0, seed=1)
    town = load_town("junctions")
    with pytest.raises(SimulatorFailedError, match="no-such-edge"):
        Simulator().begin(town.net_file, "no-such-edge", 0.0, 0.0, 0.0, seed=1)
    episode = Episode(make_trial(), Track.STATE)
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
