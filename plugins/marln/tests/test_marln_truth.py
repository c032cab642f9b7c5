import numpy as np
import pytest

from wrongturn_marln.affordances import FARTHEST
from wrongturn_marln.truth import RoadTruth, RoadTruths
from wrongturn_networks import load_town
from wrongturn_sim import WrongturnVectorEnv
from wrongturn_sim.roads import roads_of


@pytest.fixture(scope="module")
def truth():
    return RoadTruth(load_town("Town01"))


def test_a_place_beside_a_lane(truth):
    """Half a metre to the left of a straight lane, 12 m before its stop line, turned by 0.1 to the right."""
    roads = roads_of(load_town("Town01"))
    leg = next(k for k, lane in enumerate(roads.lanes) if roads.approaches[k] and lane.length > 60.0)
    lane = roads.lanes[leg]
    places = [lane.length - 12.0, lane.length - 11.0]
    (x, x2), (y, y2) = (np.interp(places, lane.along, lane.points[:, k]) for k in (0, 1))
    yaw = np.arctan2(y2 - y, x2 - x)
    pose = np.array([[x - 0.5 * np.sin(yaw), y + 0.5 * np.cos(yaw), yaw - 0.1]])
    found = truth.of(pose)
    assert found.inside.tolist() == [0.0]
    assert found.distance.item() == pytest.approx(12.0, abs=0.05)
    assert found.lateral.item() == pytest.approx(0.5, abs=0.02)
    assert found.angle.item() == pytest.approx(-0.1, abs=0.02)


def test_groups_of_cars_are_each_in_their_own_town(truth):
    here, there = (WrongturnVectorEnv(3, town, "state", task="cruise") for town in ("Town01", "Town02"))
    placed = []
    for envs in (here, there):
        envs.reset(seed=1)
        placed.append((envs.town, envs.poses.copy()))
        envs.close()
    found = RoadTruths().of([*placed, placed[0]])
    own = [truth.of(placed[0][1]), RoadTruth(load_town("Town02")).of(placed[1][1])]
    for together, first, second in zip(found, *own, strict=True):
        assert together.tolist() == [*first.tolist(), *second.tolist(), *first.tolist()]


def test_cars_of_the_privileged_track_know_the_same(truth):
    """What the simulation shows of lanes, stop lines and junctions agrees wherever cars wander."""
    random = np.random.default_rng(1)
    envs = WrongturnVectorEnv(
        40,
        "Town01",
        "privileged",
        task="cruise",
        strict=True,
        record=False,
        autoreset_mode="SameStep",
        journeys={"near_junctions": 0.4, "inside_junctions": 0.3, "lateral": 0.4, "yaw": 0.05},
    )
    seen, _ = envs.reset(seed=1)
    counts = np.zeros(3)
    for _ in range(12):
        found = truth.of(envs.poses)
        ahead, inside = seen["stop_line"][:, 0], seen["exits_mask"].any(1) & (seen["stop_line"][:, 0] < 0)
        # At the lines themselves the middle of the body may be on either side.
        clear = (ahead > 1.0) | (ahead < 0.0)
        told = found.inside.numpy() > 0.5
        assert (told[ahead > 1.0] == 0.0).all()
        assert (told == inside)[clear].mean() > 0.9
        near = (ahead > 1.0) & (ahead < FARTHEST)
        np.testing.assert_allclose(found.distance.numpy()[near], ahead[near], atol=0.35)
        straight = ahead > 5.0
        first, second = seen["lane"][straight, 0], seen["lane"][straight, 3]
        pose = seen["pose"][straight]
        along = second - first
        heading = np.arctan2(along[:, 1], along[:, 0])
        offset = pose[:, :2] - first
        lateral = offset[:, 1] * np.cos(heading) - offset[:, 0] * np.sin(heading)
        turned = (pose[:, 2] - heading + np.pi) % (2 * np.pi) - np.pi
        ours = found.lateral.numpy()[straight], found.angle.numpy()[straight]
        assert np.median(abs(ours[0] - lateral)) < 0.05
        assert np.median(abs(ours[1] - turned)) < 0.02
        counts += near.sum(), inside.sum(), straight.sum()
        steer = random.normal(0.0, 0.1, 40)
        seen, *_ = envs.step(np.stack([steer, np.full(40, 0.5), np.zeros(40)], 1).astype(np.float32))
    envs.close()
    assert (counts > 40).all()
