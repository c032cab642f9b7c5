import hashlib
import math
import subprocess
import sys

import numpy as np
import pytest
from shapely import STRtree
from shapely.geometry import LineString, Point, Polygon

from wrongturn_networks import load_town
from wrongturn_protocol import Command, FaultKind, SegmentationClass, Track, Traffic, Verdict
from wrongturn_sim import Episode, JudgeGeometry, Simulator, TrafficTooDenseError, Trajectory, judge
from wrongturn_sim import simulator as bridge
from wrongturn_sim.route import start_pose
from wrongturn_sim.traffic.plan import BODIES, DRIVE_LENGTH, TrafficCar, TrafficPlan, Trip, plan_traffic
from wrongturn_sim.view.window import box as corners

EGO = (4.6, 1.9)


def box(x, y, yaw, length, width, *_):
    return Polygon(corners(x, y, yaw, length, width))


@pytest.fixture
def crowded(make_trial):
    def make(vehicles=20, pedestrians=10, **more):
        return make_trial(traffic=Traffic(vehicles=vehicles, pedestrians=pedestrians), **more)

    return make


def planned(trial):
    town = load_town(trial.town)
    return plan_traffic(town, trial, start_pose(town, trial))


def begin(trial):
    """The drive of a trial without an episode around it, and the ego's start."""
    town = load_town(trial.town)
    start = start_pose(town, trial)
    return Simulator().begin(town.net_file, *start, planned(trial), seed=trial.seed), start


class TestPlan:
    def test_it_is_the_seeds(self, crowded):
        trial = crowded(town="Town01", seed=4)
        assert planned(trial) == planned(trial)
        assert planned(trial) != planned(trial.model_copy(update={"seed": 5}))
        assert planned(crowded(0, 0)) is None

    def test_a_trial_and_its_twin_meet_the_same_people(self, crowded):
        trial = crowded(fault=FaultKind.INFEASIBLE)
        assert planned(trial) == planned(trial.twin())

    def test_how_many_walk_does_not_change_who_drives(self, crowded):
        assert planned(crowded(10, 0)).cars == planned(crowded(10, 30)).cars
        assert planned(crowded(0, 30)).pedestrians == planned(crowded(10, 30)).pedestrians

    @pytest.mark.parametrize("name", ["Town01", "Town02", "junctions"])
    def test_everybody_has_a_long_way_by_lanes_that_lead_into_each_other(self, crowded, name):
        town = load_town(name)
        lanes = {lane.edge: lane for lane in town.lanes.values()}
        plan = planned(crowded(40, 40, town=name))
        assert (len(plan.cars), len(plan.pedestrians)) == (40, 40)
        for car in plan.cars:
            way = 0.0
            for trip in car.trips:
                assert 0.0 < trip.at < 1.0
                assert town.lanes[trip.lane].edge == trip.edges[0]
                for edge, onward in zip(trip.edges, trip.edges[1:], strict=False):
                    exits = town.approach_of_lane(lanes[edge].id).exits.values()
                    assert lanes[onward].id in {one.lane for one in exits}
                way += sum(lanes[edge].length for edge in trip.edges) - trip.at * lanes[trip.edges[0]].length
            assert way >= DRIVE_LENGTH
        assert all(1.2 <= person.speed <= 1.6 for person in plan.pedestrians)
        assert len({car.body for car in plan.cars}) > 2

    @pytest.mark.parametrize(("field", "counts"), [("vehicles", (200, 0)), ("vehicles", (200, 200))])
    def test_more_than_a_town_holds_is_refused_by_name(self, crowded, field, counts):
        with pytest.raises(
            TrafficTooDenseError, match=rf"traffic\.{field}: junctions has room for \d+ .*ask for fewer"
        ):
            Episode(crowded(*counts), Track.STATE)


class TestBeginning:
    @pytest.mark.parametrize(
        ("name", "vehicles", "pedestrians"), [("Town01", 200, 50), ("Town02", 150, 200), ("junctions", 60, 20)]
    )
    def test_all_are_there_apart_from_each_other_and_clear_of_the_car(self, crowded, name, vehicles, pedestrians):
        for seed in range(3):
            trial = crowded(vehicles, pedestrians, town=name, seed=seed)
            drive, start = begin(trial)
            sumo = bridge.load_libsumo()
            assert (sumo.vehicle.getIDCount(), sumo.person.getIDCount()) == (vehicles + 1, pedestrians)
            seen = [user for user in drive.road_users() if user[3] > 1.0]
            assert all(math.hypot(user[0] - start.x, user[1] - start.y) > 12.0 for user in seen)
            boxes = [box(*user) for user in seen]
            pairs = STRtree(boxes).query(boxes, predicate="intersects")
            assert (pairs[0] == pairs[1]).all()

    def test_they_drive_already(self, crowded):
        speeds = [user[5] for user in begin(crowded(20, 0, town="Town02"))[0].road_users()]
        assert len(speeds) > 3
        assert min(speeds) > 1.0


class TestWhatIsSeen:
    def test_the_record_and_the_observation_hold_the_nearest_first(self, crowded):
        episode = Episode(crowded(60, 60), Track.PRIVILEGED)
        observation = episode.reset()
        for _ in range(15):
            row = episode.trajectory.rows[-1]
            away = [math.hypot(user[0] - row.x, user[1] - row.y) for user in row.road_users]
            assert away == sorted(away)
            assert away[-1] <= 80.0
            count = min(32, len(away))
            assert observation["road_users_count"] == [count]
            expected = np.array(row.road_users[:count], np.float32)
            assert np.array_equal(observation["road_users"][:count], expected)
            assert not observation["road_users"][count:].any()
            observation = episode.step(0.0, 0.2, 0.0).observation
        assert len(episode.trajectory.rows[0].road_users) > 32

    def test_places_are_of_the_bodys_centre(self, crowded):
        drive, start = begin(crowded(20, 5))
        sumo = bridge.load_libsumo()
        for _ in range(40):
            drive.move(*start)
        fronts = {
            tuple(round(value, 2) for value in sumo.vehicle.getPosition(name)) for name in sumo.vehicle.getIDList()
        }
        seen = [user for user in drive.road_users() if user[3] > 1.0]
        assert len(seen) > 5
        for x, y, yaw, length, _, speed in seen:
            front = (x + length / 2 * math.cos(yaw), y + length / 2 * math.sin(yaw))
            assert min(math.dist(front, other) for other in fronts) < 0.02
            assert -math.pi <= yaw <= math.pi
            assert 0.0 <= speed < 25.0

    def test_pictures_get_height_kind_and_a_colour_that_stays(self, crowded):
        drive, start = begin(crowded(30, 30))
        before = None
        for _ in range(60):
            drive.move(*start)
            others, users = drive.others(), drive.road_users()
            assert others.shape == (len(users), 8)
            assert others.dtype == np.float64
            assert np.array_equal(others[:, :5], np.array(users)[:, :5])
            walking = others[:, 6] == 1
            assert np.array_equal(walking, others[:, 3] == 0.5)
            assert ((others[:, 5] > 1.4) & (others[:, 5] < 2.5)).all()
            if before is not None:  # whoever is nearest to where somebody was is the same one
                for x, y, *_, kind, colour in others[others[:, 6] == 0]:
                    gap = np.hypot(before[:, 0] - x, before[:, 1] - y)
                    if gap.min() < 0.3:
                        assert (before[gap.argmin()][6:] == (kind, colour)).all()
            before = others
        assert len(set(others[:, 7])) > 5

    def test_a_camera_shows_them(self, crowded, make_trial):
        seen = []
        for trial in (crowded(40, 60, approach="J1-S"), make_trial(approach="J1-S")):
            episode = Episode(trial, Track.SEGMENTATION)
            episode.reset()
            for _ in range(5):
                classes = episode.step(0.0, 0.3, 0.0).observation["segmentation"]
            seen.append({SegmentationClass.VEHICLE, SegmentationClass.PEDESTRIAN} & set(classes.ravel().tolist()))
        assert seen == [{SegmentationClass.VEHICLE, SegmentationClass.PEDESTRIAN}, set()]

    def test_cars_keep_to_the_road_and_people_off_it(self, crowded):
        trial = crowded(30, 60, town="Town02", seed=2)
        town = load_town(trial.town)
        drive, start = begin(trial)
        for k in range(400):
            drive.move(*start)
            if k % 20:
                continue
            for x, y, _, length, _, speed in drive.road_users():
                if length > 1.0:
                    assert town.road.buffer(0.3).contains(Point(x, y))
                else:
                    assert town.sidewalks.buffer(0.3).contains(Point(x, y))
                    assert speed <= 1.61


class TestTheyMindTheCar:
    @pytest.mark.parametrize("past_stop_line", [-4.0, 8.0])
    def test_nobody_runs_into_a_car_that_stands(self, crowded, past_stop_line):
        """Before the stop line somebody queues behind it; in the junction others wait for it."""
        queued = False
        for seed in (1, 3):
            trial = crowded(24, 10, town="Town02", seed=seed)
            town = load_town(trial.town)
            approach = town.approach(trial.approach)
            lane = town.lanes[approach.lane]
            way = LineString([*lane.centreline, *approach.exits[trial.route].path[1:]])
            goal = lane.length + past_stop_line
            drive, _ = begin(trial)
            s = lane.length - trial.start.distance
            for k in range(700):
                s = min(s + 0.25, goal)
                at, behind = way.interpolate(s), way.interpolate(s - 0.1)
                yaw = math.atan2(at.y - behind.y, at.x - behind.x)
                drive.move(at.x, at.y, yaw)
                if k % 4 == 0:
                    ego = box(at.x, at.y, yaw, *EGO)
                    near = [user for user in drive.road_users()[:4] if math.dist(user[:2], (at.x, at.y)) < 9.0]
                    assert not any(ego.intersects(box(*user)) for user in near), (seed, k)
                    queued |= k > 200 and any(
                        user[5] < 0.1
                        and user[3] > 1.0
                        and (user[0] - at.x) * math.cos(yaw) + (user[1] - at.y) * math.sin(yaw) < -4.0
                        for user in near
                    )
        assert queued or past_stop_line > 0.0

    @pytest.mark.parametrize("comes", [True, False])
    def test_who_must_give_way_gives_way(self, comes):
        """A car from the side street lets the ego pass that comes along the main one, and only then turns in."""
        town = load_town("junctions")
        lane = town.lanes["J2-J1_1"]
        onward = town.approach("J1-E").exits[Command.STRAIGHT]
        way = LineString([*lane.centreline, *onward.path[1:], *town.lanes[onward.lane].centreline[1:]])
        other = TrafficCar(BODIES[1], (Trip("S-J1_1", 0.35, ("S-J1", "J1-W")),), 0)
        plan = TrafficPlan((other,), (), ("J2-J1", "J1-W"))
        at = way.interpolate(20.0)
        drive = Simulator().begin(town.net_file, at.x, at.y, math.pi, plan, seed=1)
        sumo = bridge.load_libsumo()
        stood = turned = False
        for k in range(1, 300):
            at = way.interpolate(min(20.0 + comes * 0.4 * k, way.length))
            drive.move(at.x, at.y, math.pi)
            stood |= sumo.vehicle.getSpeed("v0") < 0.1
            if sumo.vehicle.getRoadID("v0") == "J1-W":
                turned = True
                break
        assert stood == comes
        assert turned
        assert not comes or at.x < town.approach("J1-E").stop_line[0]

    def test_the_car_may_go_where_no_road_is(self, crowded):
        drive, start = begin(crowded(20, 10))
        for k in range(60):
            drive.move(-300.0 + 10.0 * k, 200.0 - 7.0 * k, 0.1 * k)
        assert len(drive.road_users()) < 30
        drive.move(*start)
        assert len(drive.road_users()) > 5

    @pytest.mark.parametrize(
        ("counts", "approach", "seed", "action"),
        [((40, 0), "J1-S", 1, (0.0, 1.0, 0.0)), ((0, 200), "J1-E", 7, (0.1, 0.6, 0.0))],
        ids=["car", "pedestrian"],
    )
    def test_who_rams_another_has_collided_and_the_record_alone_says_so(self, crowded, counts, approach, seed, action):
        episode = Episode(crowded(*counts, approach=approach, seed=seed), Track.STATE)
        episode.reset()
        while episode.outcome is None:
            episode.step(*action)
        assert episode.outcome.verdict is Verdict.COLLISION
        assert episode.outcome.min_ttc == 0.0
        *before, last = episode.trajectory.rows
        ego = box(last.x, last.y, last.yaw, *EGO)
        assert any(ego.intersects(box(*user)) for user in last.road_users)
        ego = box(before[-1].x, before[-1].y, before[-1].yaw, *EGO)
        assert not any(ego.intersects(box(*user)) for user in before[-1].road_users)
        again = Trajectory.from_json(episode.trajectory.to_json())
        assert judge(again, JudgeGeometry.of(episode.town, again.trial)) == episode.outcome
        again.rows[:] = [row._replace(road_users=()) for row in again.rows]
        assert judge(again, JudgeGeometry.of(episode.town, again.trial)) != episode.outcome

    def test_coming_near_shows_in_the_time_to_collision(self, crowded):
        trial = crowded(40, 0, approach="J1-S", seed=1)
        times = []
        for traffic in (trial.traffic, Traffic()):
            episode = Episode(trial.model_copy(update={"traffic": traffic}), Track.STATE)
            episode.reset()
            for _ in range(8):
                episode.step(0.0, 0.5, 0.0)
            times.append(episode.abort().min_ttc)
        assert times[0] is not None
        assert times[0] < (times[1] or math.inf)


class TestStaying:
    def test_who_leaves_the_small_town_comes_back(self, crowded):
        drive, start = begin(crowded(12, 6))
        sumo = bridge.load_libsumo()
        left = 0
        counts = []
        for _ in range(800):
            drive.move(*start)
            left += len(sumo.simulation.getArrivedIDList())
            counts.append(sumo.vehicle.getIDCount() - 1)
        assert left > 6
        assert min(counts) >= 9
        assert np.mean(counts) > 11
        assert sumo.person.getIDCount() == 6

    def test_nobody_leaves_a_town(self, crowded):
        drive, start = begin(crowded(20, 20, town="Town02"))
        for _ in range(810):
            drive.move(*start)
        sumo = bridge.load_libsumo()
        assert (sumo.vehicle.getIDCount(), sumo.person.getIDCount()) == (21, 20)


def digest_of(trial, steps=60):
    """Of everything that an episode shows and records."""
    episode = Episode(trial, Track.PRIVILEGED)
    observation = episode.reset()
    digest = hashlib.sha256()
    for k in range(steps):
        digest.update(b"".join(observation[name].tobytes() for name in sorted(observation)))
        if episode.outcome is not None:
            break
        observation = episode.step(0.05 * math.sin(k / 3), 0.4, 0.0).observation
    digest.update(episode.trajectory.to_json())
    return digest.hexdigest()


SAME = """
import sys
from wrongturn_protocol import Trial
sys.path.insert(0, sys.argv[1])
from test_traffic import digest_of
trials = [Trial.model_validate_json(line) for line in sys.stdin]
print("\\n".join(reversed([digest_of(trial) for trial in reversed(trials)])))
"""


class TestTheSame:
    def test_whatever_was_driven_before(self, crowded, make_trial):
        trial, lonely = crowded(seed=3), make_trial(seed=3)
        first, alone = digest_of(trial), digest_of(lonely)
        digest_of(crowded(50, 50, seed=9), steps=13)
        digest_of(crowded(seed=5, town="Town02"), steps=5)
        assert digest_of(trial) == first
        assert digest_of(trial) == first
        assert digest_of(lonely) == alone
        assert digest_of(trial) == first

    def test_in_two_processes(self, crowded, make_trial):
        trials = [crowded(seed=3), crowded(20, 20, town="Town01", seed=4), make_trial(fault="infeasible", seed=5)]
        here = [digest_of(trial) for trial in trials]
        folder = __file__.rpartition("/")[0]
        there = subprocess.run(
            [sys.executable, "-c", SAME, folder],
            input="\n".join(trial.model_dump_json() for trial in trials),
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        assert there.stdout.split() == here
        assert len(set(here)) == 3
