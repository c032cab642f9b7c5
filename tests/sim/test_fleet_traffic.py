"""Traffic of a batch: seen, judged and hit as SUMO's; the same whatever the threads; and nobody hits anybody."""

import math

import numpy as np
import pytest
from shapely import STRtree
from shapely.geometry import Point, Polygon

from wrongturn_networks import draw_cruise, load_town
from wrongturn_protocol import DIRECTIONS, SegmentationClass, Traffic
from wrongturn_sim import (
    FleetTraffic,
    JourneyGeometry,
    JourneyJudge,
    TrafficTooDenseError,
    TrialNotAloneError,
    WrongturnVectorEnv,
)
from wrongturn_sim.camera import Camera, Renderer, World
from wrongturn_sim.view.window import box as corners

EGO = (4.6, 1.9)
LEADERS = FleetTraffic(leaders=0.5)
BUSY = Traffic(vehicles=40, pedestrians=30)


def made(count=8, track="privileged", town="Town02", traffic=BUSY, own=LEADERS, **more):
    more = {"task": "cruise", "autoreset_mode": "Disabled", **more}
    return WrongturnVectorEnv(count, town, track, traffic=traffic, own_traffic=own, **more)


def box(x, y, yaw, length, width, *_):
    return Polygon(corners(x, y, yaw, length, width))


def users_of(observation, i):
    return observation["road_users"][i, : int(observation["road_users_count"][i, 0])].astype(float)


def begun_anew(envs, over):
    """Begin new drives where they are over, and return the observation."""
    return envs.reset(options={"reset_mask": over})[0] if over.any() else envs._observation()


def driver(observation, i, *, brakes):
    """Follow the lane or the commanded exit; brake for whoever is straight ahead, or drive on."""
    x, y, yaw = observation["pose"][i].tolist()
    command, v = int(observation["command"][i, 0]), float(observation["speed"][i, 0])
    path = observation["lane"][i]
    if command in DIRECTIONS and observation["exits_mask"][i, DIRECTIONS.index(command)]:
        path = observation["exits"][i, DIRECTIONS.index(command)]
    away = np.hypot(path[:, 0] - x, path[:, 1] - y)
    nearest = int(away.argmin())
    further = np.flatnonzero(away[nearest:] > 4.5)
    tx, ty = path[nearest + (int(further[0]) if len(further) else 0)].tolist()
    dx, dy = tx - (x - 1.45 * math.cos(yaw)), ty - (y - 1.45 * math.sin(yaw))
    angle = math.remainder(math.atan2(dy, dx) - yaw, math.tau)
    steer = -math.atan(2 * 2.9 * math.sin(angle) / max(math.hypot(dx, dy), 1.0)) / math.radians(35)
    wanted = 8.0 if command == 4 else 4.0
    if brakes:
        for ux, uy, _, length, _, speed in users_of(observation, i).tolist():
            ahead = (ux - x) * math.cos(yaw) + (uy - y) * math.sin(yaw)
            left = (uy - y) * math.cos(yaw) - (ux - x) * math.sin(yaw)
            if ahead > 0.0 and abs(left) < 2.2:
                gap = ahead - 2.3 - length / 2 - 3.0
                wanted = min(wanted, math.sqrt(max(0.0, 4.0 * gap)) + 0.5 * speed * (gap > 0.0))
    error = wanted - v
    return min(1.0, max(-1.0, steer)), min(1.0, max(0.0, error)), min(1.0, max(0.0, -error))


@pytest.mark.parametrize("track", ["segmentation", "camera"])
def test_a_road_user_looks_as_in_an_episode(track):
    """An episode renders with this function, which takes the road users that SUMO reports."""
    envs = made(6, track, weather=["ClearNoon", "HardRainNoon"], threads=2)
    observation, _ = envs.reset(seed=4)
    fleet, world = envs._fleet, World.of(load_town("Town02"))
    classes = set()
    for _ in range(12):
        for i, trial in enumerate(envs.trials):
            others, begins = fleet.others(np.array([i]))
            assert begins.tolist() == [0, len(others)]
            rgb, segmentation = Renderer(world, Camera(), trial.weather, trial.seed).render(
                *fleet.poses[i], int(fleet.steps[i]), others
            )
            assert np.array_equal(observation["rgb"][i], rgb)
            if track == "segmentation":
                assert np.array_equal(observation["segmentation"][i], segmentation)
            classes |= set(np.unique(segmentation).tolist())
        observation = envs.step(np.tile(np.float32([0.0, 0.2, 0.0]), (6, 1)))[0]
    assert {int(SegmentationClass.VEHICLE), int(SegmentationClass.PEDESTRIAN)} <= classes


def test_a_road_user_is_hit_and_judged_as_in_an_episode():
    envs = made(16, strict=True, own=FleetTraffic(hesitant=1.0, leaders=1.0), journeys={"time_limit": 20.0})
    observation, _ = envs.reset(seed=1)
    geometry, hit = JourneyGeometry.of(load_town("Town02")), 0
    for _ in range(240):
        actions = np.array([driver(observation, i, brakes=False) for i in range(16)], np.float32)
        _, _, terminated, truncated, infos = envs.step(actions)
        over = terminated | truncated
        for i in np.flatnonzero(over):
            record = envs.episode(i)
            rows = record.trajectory.rows
            judge = JourneyJudge(geometry, record.trajectory.trial, strict=True)
            found = [outcome for outcome in map(judge.observe, rows) if outcome is not None]
            if infos["verdict"][i] != "not_engaged":  # who waits for others does not stand, in training only
                assert found == [record.outcome]
            if infos["verdict"][i] == "collision" and rows[-1].road_users:
                ego = box(rows[-1].x, rows[-1].y, rows[-1].yaw, *EGO)
                hit += any(ego.intersects(box(*user)) for user in rows[-1].road_users)
                assert not any(box(*rows[-3][1:4], *EGO).intersects(box(*user)) for user in rows[-3].road_users)
        observation = begun_anew(envs, over)
    assert hit >= 3


def test_the_same_seed_gives_the_same_bytes_whatever_the_threads():
    def run(threads):
        envs = made(9, "segmentation", threads=threads, strict=True)
        seen = [envs.reset(seed=7)[0]]
        for k in range(30):
            observation, rewards, terminated, truncated, _ = envs.step(
                np.tile(np.float32([0.02 * (-1) ** k, 0.5, 0.0]), (9, 1))
            )
            seen.append({**observation, "rewards": rewards})
            begun_anew(envs, terminated | truncated)
        return [{name: array.tobytes() for name, array in one.items()} for one in seen]

    first = run(1)
    assert run(1) == first
    assert run(4) == first


def test_traffic_does_not_change_drives_without():
    """A batch that may have traffic, and one that may not, drive the same lonely trials alike."""
    town, random = load_town("Town02"), np.random.default_rng(3)
    trials = [draw_cruise(town, random) for _ in range(6)]
    runs = []
    for own in (None, FleetTraffic()):
        envs = WrongturnVectorEnv(6, "Town02", task="cruise", own_traffic=own, autoreset_mode="Disabled")
        envs.reset(seed=1, options={"trial": trials})
        for _ in range(60):
            rewards = envs.step(np.tile(np.float32([0.0, 0.3, 0.0]), (6, 1)))[1] if not envs._fleet.ended.any() else 0
        runs.append((rewards, [envs.episode(i).trajectory.to_json() for i in range(6)]))
    assert np.array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1]


@pytest.mark.parametrize(("name", "traffic"), [("Town01", Traffic(vehicles=60, pedestrians=50)), ("Town02", BUSY)])
def test_nobody_hits_anybody(name, traffic):
    """Cars keep apart from each other, from a car that stands anywhere and from one that brakes for them."""
    town = load_town(name)
    road, pavement = town.road.buffer(0.3), town.sidewalks.buffer(0.3)
    envs = made(6, town=name, traffic=traffic, own=FleetTraffic(hesitant=0.3, crossers=0.5, waiters=0.5),
                drive_on=60.0)  # fmt: skip
    observation, _ = envs.reset(seed=2)
    speeds = []
    for k in range(599):
        actions = np.array([driver(observation, i, brakes=True) for i in range(6)], np.float32)
        actions[3:] = 0.0, 0.0, 1.0
        observation = envs.step(actions)[0]
        if k % 4:
            continue
        for i in range(6):
            users = users_of(observation, i)
            boxes = [box(*user) for user in users if user[3] > 1.0]
            ours = box(*observation["pose"][i].tolist(), *EGO)
            if i >= 3:
                assert not any(ours.intersects(other) for other in boxes), (k, i)
            if boxes:
                pairs = STRtree(boxes).query(boxes, predicate="intersects")
                assert (pairs[0] == pairs[1]).all(), (k, i)
            for x, y, _, length, _, speed in users.tolist():
                assert (road if length > 1.0 else pavement).contains(Point(x, y))
                if length > 1.0:
                    speeds.append(speed)
    speeds = np.array(speeds)
    assert 0.02 < (speeds < 0.3).mean() < 0.6
    assert 3.0 < speeds.mean() < 13.0


def test_who_brakes_for_others_earns_more_and_who_waits_may_stand():
    earned, verdicts, waited = {}, {}, 0
    for brakes in (True, False):
        envs = made(12, town="Town01", traffic=Traffic(vehicles=60, pedestrians=20), strict=True,
                    own=FleetTraffic(hesitant=0.5, leaders=1.0), journeys={"time_limit": 30.0})  # fmt: skip
        observation, _ = envs.reset(seed=5)
        total, found, stood = np.zeros(12), [None] * 12, np.zeros(12)
        for _ in range(299):
            alive = np.array([verdict is None for verdict in found])
            actions = np.array([driver(observation, i, brakes=brakes) for i in range(12)], np.float32)
            observation, rewards, terminated, truncated, infos = envs.step(actions)
            total += rewards * alive
            stood = np.where(observation["speed"][:, 0] < 0.3, stood + 0.1, 0.0)
            waited += int((alive & envs.waits & (stood > 5.0)).any())
            over = terminated | truncated
            for i in np.flatnonzero(over & alive):
                found[i] = infos["verdict"][i]
            observation = begun_anew(envs, over)
        earned[brakes], verdicts[brakes] = total.sum(), found
    assert verdicts[False].count("collision") >= verdicts[True].count("collision") + 3
    assert earned[True] > 1.1 * earned[False]
    assert verdicts[True].count("not_engaged") == 0
    assert waited > 0


@pytest.mark.parametrize("town", ["Town01", "Town02"])
def test_cars_with_the_right_of_way_mind_a_car_in_the_junction_and_the_reward_asks_to_stop_for_the_others(town):
    """An ego that gives way to nobody is hit by few, and has been told to stop long before by v*."""
    envs = made(32, town=town, traffic=Traffic(vehicles=8), strict=True, own=FleetTraffic(crossers=1.0),
                journeys={"near_junctions": 1.0, "near_bends": 0.0, "time_limit": 30.0})  # fmt: skip
    observation, _ = envs.reset(seed=3)
    found, asked = [None] * 32, np.zeros(32)
    for _ in range(120):
        stop = envs.waits
        asked = np.where(stop, asked + 1, 0)
        actions = np.array([driver(observation, i, brakes=False) for i in range(32)], np.float32)
        _, _, terminated, truncated, infos = envs.step(actions)
        over = terminated | truncated
        for i in np.flatnonzero(over):
            found[i] = found[i] or infos["verdict"][i]
            if infos["verdict"][i] == "collision":
                assert asked[i] >= 6
        observation = begun_anew(envs, over)
    assert found.count("collision") <= 4


def test_at_junctions_with_crossers_the_ego_has_to_give_way_more_often():
    waits = []
    for share in (0.0, 1.0):
        envs = made(64, track="state", town="Town01", traffic=Traffic(vehicles=6), own=FleetTraffic(crossers=share),
                    journeys={"near_junctions": 1.0, "near_bends": 0.0}, autoreset_mode="SameStep")  # fmt: skip
        envs.reset(seed=2)
        waiting = 0
        for _ in range(60):
            envs.step(np.tile(np.float32([0.0, 0.15, 0.0]), (64, 1)))
            waiting += int(envs.waits.sum())
        waits.append(waiting)
    assert waits[1] > 2 * waits[0] + 100


def test_waiters_stand_at_the_stop_line_ahead_or_at_that_of_the_street_into_which_the_ego_turns():
    town = load_town("Town01")
    envs = made(32, town="Town01", traffic=Traffic(vehicles=6), own=FleetTraffic(waiters=1.0), task=None, fault="none",
                drive_on=22.0)  # fmt: skip
    observation, _ = envs.reset(seed=1)
    approaches = [town.approach(trial.approach) for trial in envs.trials]
    exits = [
        town.lanes[approach.exits[trial.route].lane].opposite
        for approach, trial in zip(approaches, envs.trials, strict=True)
    ]
    lines = np.array(
        [(a.stop_line, town.approach_of_lane(b).stop_line) for a, b in zip(approaches, exits, strict=True)]
    )
    stood, turned, gone_early, blocked = np.zeros((32, 2), np.int64), np.zeros(32, np.bool_), 0, 0
    for _ in range(219):
        there = np.zeros((32, 2), np.bool_)
        for i in range(32):
            for x, y, yaw, length, _, speed in users_of(observation, i).tolist():
                front = x + 0.5 * length * math.cos(yaw), y + 0.5 * length * math.sin(yaw)
                there[i] |= (np.hypot(*(lines[i] - front).T) < 2.0) & (speed == 0.0)
            inside = town.junctions[approaches[i].junction].area.contains(Point(observation["pose"][i, :2]))
            turned[i] |= inside
            gone_early += inside and stood[i, 1] > 20 and not there[i, 1]
        stood += there
        blocked += int((there[:, 0] & envs.waits).sum())
        actions = np.array([driver(observation, i, brakes=True) for i in range(32)], np.float32)
        observation = envs.step(actions)[0]
    waited = (stood > 20).sum(axis=0)
    assert ((stood > 20).any(axis=1)).mean() > 0.8
    assert waited.min() >= 5
    assert stood[:, 0].max() < 180  # it drives on
    assert (turned.sum(), gone_early) == (32, 0)
    assert blocked > 100


class TestRefusals:
    def test_without_traffic_of_its_own_a_batch_drives_alone(self, make_trial):
        with pytest.raises(ValueError, match=r"traffic: the cars of one batch drive alone.*own_traffic=FleetTraffic"):
            made(own=None)
        envs = WrongturnVectorEnv(2, "junctions")
        crowded = make_trial(traffic=BUSY)
        with pytest.raises(TrialNotAloneError, match="traffic"):
            envs.reset(seed=1, options={"trial": crowded})

    def test_more_than_a_town_holds_is_refused_by_name(self):
        envs = made(1, town="junctions", traffic=Traffic(vehicles=60), task=None, fault="none")
        with pytest.raises(TrafficTooDenseError, match=r"traffic\.vehicles: junctions has room for 38"):
            envs.reset(seed=1)

    @pytest.mark.parametrize("name", ["hesitant", "leaders", "crossers", "waiters"])
    def test_shares_are_shares(self, name):
        with pytest.raises(ValueError, match=rf"{name}: is 1.5; give a share from 0 to 1"):
            FleetTraffic(**{name: 1.5})


def test_a_small_town_has_traffic_that_leaves_and_comes_back():
    envs = made(
        4, town="junctions", traffic=Traffic(vehicles=20, pedestrians=5), task=None, fault="none", drive_on=60.0
    )
    envs.reset(seed=3)
    near, counts = [], []
    for _ in range(590):
        observation = envs.step(np.tile(np.float32([0.0, 0.0, 1.0]), (4, 1)))[0]
        near.append(observation["road_users_count"][:, 0].copy())
    counts = np.array(near)
    assert counts[-100:].mean() > 2.0
    assert len(np.unique(counts[:, 0])) > 3
