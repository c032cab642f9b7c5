"""Drives across a town: in single episodes, among many egos, among SUMO's road users."""

import math

import numpy as np
import pytest
from shapely import LineString, Point

from wrongturn_networks import draw_journey, load_town
from wrongturn_protocol import DIRECTIONS, Command, OptionError, Task, Track, Traffic, Verdict
from wrongturn_sim import Episode, JourneyGeometry, Trajectory, WrongturnSimEnv, WrongturnVectorEnv, judge
from wrongturn_sim.route import start_pose
from wrongturn_sim.simulator_process import EnvironmentSimulator
from wrongturn_sim.traffic.plan import plan_traffic

TOWNS = ("Town01", "Town02")


class Pilot:
    """Follows the lanes, and at junctions the exit that was commanded, by what the privileged track shows."""

    def __init__(self, steer, *, pace=6.0, errs=False):
        self._steer = steer
        self._pace = pace
        self._errs = errs  # takes another exit at the first junction
        self._exit = None
        self._windows = 0
        self._within = False

    def act(self, seen):
        stop_line, command = float(seen["stop_line"][0]), int(seen["command"][0])
        within = command in list(DIRECTIONS)
        self._windows += within and not self._within
        self._within = within
        if within:
            self._exit = command - 1
            if self._errs and self._windows == 1 and seen["exits_mask"].any():
                self._exit = next(k for k in range(3) if seen["exits_mask"][k] and k != command - 1)
        by_exit = stop_line < 4.0 and self._exit is not None and seen["exits_mask"][self._exit]
        path = seen["exits"][self._exit] if by_exit else seen["lane"]
        pace = 0.0 if self._blocked(seen) else self._pace
        throttle, brake = (0.5, 0.0) if float(seen["speed"][0]) < pace else (0.0, 0.1 if pace else 1.0)
        return self._steer(seen["pose"], path.astype(float)), throttle, brake

    def _blocked(self, seen):
        x, y, yaw = seen["pose"]
        c, s = math.cos(yaw), math.sin(yaw)
        for other in seen["road_users"][: int(seen["road_users_count"][0])]:
            dx, dy = other[0] - x, other[1] - y
            ahead, aside, turned = dx * c + dy * s, dy * c - dx * s, math.remainder(other[2] - yaw, math.tau)
            if 0.0 < ahead < 14.0 and abs(aside) < 1.8 and abs(turned) < 1.6:
                return True
        return False


@pytest.fixture(scope="module")
def travel(steer):
    """Drive a trial to its end; ``swerve`` names decisions with a steering of their own."""

    def driven(trial, swerve=None, watch=None, **arguments):
        chosen = {name: arguments.pop(name) for name in ("strict", "simulator") if name in arguments}
        episode = Episode(trial, Track.PRIVILEGED, **chosen)
        pilot = Pilot(steer, **arguments)
        seen = episode.reset()
        while episode.outcome is None:
            action = pilot.act(seen)
            if swerve and episode.steps in swerve:
                action = (swerve[episode.steps], *action[1:])
            step = episode.step(*action)
            seen = step.observation
            if watch:
                watch()
        assert (step.terminated, step.truncated) == (not episode._judge.ran_out, episode._judge.ran_out)
        return episode

    return driven


def test_cruises_draw_windows_of_their_own():
    arguments = {"town": "Town01", "task": "cruise", "track": "privileged"}
    near = {"time_limit": 6.0, "near_junctions": 1.0, "near_bends": 0.0}
    seen = []
    for window in ((10.0, 20.0), (10.0, 10.0), (20.0, 20.0), None):
        envs = WrongturnVectorEnv(256, **arguments, journeys={**near, "window": window})
        observation, _ = envs.reset(seed=3)
        named = observation["command"][:, 0] != int(Command.LANE_FOLLOW)
        opened = [15.0 if trial.window is None else trial.window for trial in envs._fleet.trials]
        assert (named == (observation["stop_line"][:, 0] <= opened)).all()
        seen.append(int(named.sum()))
        envs.close()
    assert seen[1] < seen[3] < seen[2]


def test_cruises_that_start_inside_a_junction():
    journeys = {"time_limit": 6.0, "near_junctions": 0.0, "near_bends": 0.0, "inside_junctions": 1.0}
    arguments = {"town": "Town01", "task": "cruise", "track": "privileged", "journeys": journeys}
    envs = WrongturnVectorEnv(64, **arguments)
    observation, _ = envs.reset(seed=3)
    assert (observation["stop_line"] == -1.0).all()
    town = load_town("Town01")
    for i, trial in enumerate(envs._fleet.trials):
        path = LineString(town.approach(trial.approach).exits[trial.route].path)
        assert observation["command"][i, 0] == trial.route
        x, y, _ = envs._fleet.poses[i]
        assert path.distance(Point(x, y)) == pytest.approx(abs(trial.start.lateral), abs=0.05)
        assert path.project(Point(x, y)) == pytest.approx(-trial.start.distance, abs=0.5)
    envs.close()


@pytest.mark.parametrize("town", TOWNS)
def test_a_pilot_arrives_and_many_egos_drive_the_same(town, travel, same_in_a_batch):
    built = load_town(town)
    trials = [draw_journey(built, task, 3) for task in (Task.STRAIGHT, Task.ONE_TURN, Task.NAVIGATION)]
    episodes = [travel(trial) for trial in trials]
    for episode in episodes:
        outcome = episode.outcome
        assert outcome.verdict is Verdict.ARRIVED, episode.trial.id
        assert outcome.journey.clean
        assert outcome.journey.completion == 1.0
        assert outcome.journey.distance == pytest.approx(episode.trial.journey.length, rel=0.03)
        assert judge(Trajectory.from_json(episode.trajectory.to_json()), JourneyGeometry.of(built)) == outcome
    assert episodes[2].outcome.journey.junctions > 2
    same_in_a_batch(episodes)


def test_without_a_record_outcomes_are_the_same_and_nothing_is_kept(travel, replayed):
    trial = draw_journey(load_town("Town02"), Task.ONE_TURN, 5)
    episode = travel(trial)
    envs, ((outcome, _),) = replayed([episode], record=False)
    assert outcome == episode.outcome.model_dump(mode="json", exclude_none=True)
    with pytest.raises(ValueError, match="record=True"):
        envs.episode(0)
    kept = [getattr(envs._fleet._egos, name) for name in ("states", "commands", "inputs")]
    assert not any(array.size for array in kept)


@pytest.mark.parametrize("town", TOWNS)
def test_after_a_wrong_turn_the_way_is_planned_anew(town, travel, same_in_a_batch):
    trial = draw_journey(load_town(town), Task.NAVIGATION, 8)
    straight, lost = travel(trial), travel(trial, errs=True)
    assert lost.outcome.verdict is Verdict.ARRIVED
    assert lost.outcome.journey.clean
    assert lost.outcome.journey.distance > straight.outcome.journey.distance + 20.0
    same_in_a_batch([straight, lost])


def test_infractions_are_counted_and_strict_ends_with_the_first(travel):
    trial = draw_journey(load_town("Town01"), Task.STRAIGHT, 2)
    swerve = dict.fromkeys(range(108, 120), -0.25)
    episode = travel(trial, swerve)
    assert episode.outcome.verdict is Verdict.ARRIVED
    assert not episode.outcome.journey.clean
    assert episode.outcome.journey.wrong_lane >= 1
    for steering, verdict in ((0.25, Verdict.OFF_ROAD), (-0.25, Verdict.WRONG_WAY)):
        strict = travel(trial, dict.fromkeys(range(108, 150), steering), strict=True)
        assert strict.outcome.verdict is verdict
        assert strict.outcome.journey.completion < 1.0


def test_time_runs_out():
    arguments = {"town": "Town01", "task": "cruise", "journeys": {"time_limit": 3.0}}
    envs, single = WrongturnVectorEnv(2, **arguments), WrongturnSimEnv(**arguments)
    envs.reset(seed=7)
    single.reset(seed=7)
    for step in range(1, 31):
        _, _, terminated, truncated, infos = envs.step(np.zeros((2, 3), np.float32))
        _, _, *ended, info = single.step(np.zeros(3, np.float32))
        assert not terminated.any()
        assert ended == [terminated[0], truncated[0]]
        assert truncated.tolist() == [step == 30] * 2
    assert infos["verdict"].tolist() == ["timeout"] * 2
    assert info["outcome"] == infos["outcome"][0]


def test_a_drive_among_other_road_users(travel):
    town = load_town("Town02")
    trial = draw_journey(town, Task.NAVIGATION_DYNAMIC, 2, traffic=Traffic(vehicles=15, pedestrians=20))
    plan = plan_traffic(town, trial, start_pose(town, trial))
    assert plan.ego[0] == town.lanes[town.approach(trial.approach).lane].edge
    assert town.lanes[trial.journey.goal].edge in plan.ego
    assert all(
        sum(_lengths(town, trip.edges) for trip in car.trips) > 10 * trial.journey.time_limit for car in plan.cars
    )
    episode = travel(trial)
    assert episode.outcome.verdict is Verdict.ARRIVED
    assert episode.outcome.journey.collisions == 0
    assert any(row.road_users for row in episode.trajectory.rows[-200:])
    assert travel(trial).trajectory.sha256 == episode.trajectory.sha256


def test_others_are_told_of_the_way_after_a_wrong_turn(travel):
    import libsumo

    town = load_town("Town02")
    trial = draw_journey(town, Task.NAVIGATION_DYNAMIC, 8, traffic=Traffic(vehicles=2))
    planned = plan_traffic(town, trial, start_pose(town, trial)).ego
    routes = []

    def note():
        if not routes or routes[-1] != libsumo.vehicle.getRoute("ego"):
            routes.append(libsumo.vehicle.getRoute("ego"))

    episode = travel(trial, watch=note, errs=True)
    assert episode.outcome.verdict is Verdict.ARRIVED
    assert routes[0] == planned
    others = [way for way in town.approach(trial.approach).exits.values() if way.direction is not trial.route]
    # The new way leads on from where the car strayed to, and holds until it arrives.
    (begin,) = {town.lanes[way.lane].edge for way in others} & set(routes[-1])
    assert begin not in planned[:2]
    assert town.lanes[trial.journey.goal].edge in routes[-1][routes[-1].index(begin) :]
    # This process's simulator is taken, so an environment has one in a process of its own; it is told the same way.
    simulator = EnvironmentSimulator()
    other = travel(trial, errs=True, simulator=simulator)
    simulator.close()
    assert other.trajectory.sha256 == episode.trajectory.sha256
    assert routes[-1] == libsumo.vehicle.getRoute("ego"), "nothing else drove in this process"


def _lengths(town, edges):
    by_edge = {lane.edge: lane.length for lane in town.lanes.values()}
    return sum(by_edge[edge] for edge in edges)


@pytest.mark.parametrize(
    ("journeys", "says"),
    [
        ({"colour": "red"}, "colour: there is no such option"),
        ({"near_junction": 0.4}, r"near_junction: there is no such option; .*\. Did you mean near_junctions\?$"),
        ({"near_junctions": 2.0}, "near_junctions, near_bends, inside_junctions: .* are not shares"),
        ({"time_limit": math.nan}, "time_limit: nan is no time to drive; give seconds, more than 0$"),
        ({"time_limit": -1}, "time_limit: -1 is no time to drive; give seconds, more than 0$"),
        ({"time_limit": "long"}, "'time_limit': 'long'.* has a value of the wrong type"),
        ({"speed": 5}, "'speed': 5.* has a value of the wrong type"),
        ({"least_traffic": {"vehicles": 2}}, "'least_traffic': .* has a value of the wrong type"),
    ],
)
def test_what_is_wrong_with_journeys_is_told_in_one_line(journeys, says):
    """What other options go with journeys: ``tests/protocol/test_trial_options.py``."""
    for make in (WrongturnSimEnv, lambda **more: WrongturnVectorEnv(2, **more)):
        with pytest.raises(OptionError, match=rf"^journeys[.:].*{says}") as told:
            make(town="Town02", task="cruise", journeys=journeys)
        assert "\n" not in str(told.value)


def test_strict_is_a_truth_value():
    for strict in ("no", None):
        with pytest.raises(OptionError, match=f"strict: is {strict!r}"):
            WrongturnSimEnv(town="Town02", task="cruise", strict=strict)


@pytest.mark.parametrize("wrong", ["goal", "goal_at", "approach"])
def test_a_batch_goes_on_after_a_trial_that_it_refused(wrong):
    good = draw_journey(load_town("Town02"), Task.NAVIGATION, 3)
    changes = {"goal": {"goal": "nowhere"}, "goal_at": {"goal_at": 1e6}, "approach": {}}[wrong]
    arm = "J99-S" if wrong == "approach" else good.approach
    bad = good.model_copy(update={"approach": arm, "journey": good.journey.model_copy(update=changes)})
    environment = WrongturnVectorEnv(2, town="Town02")
    with pytest.raises(ValueError, match=r"nowhere|1000000\.0|J99-S"):
        environment.reset(options={"trial": [good, bad]})
    _, infos = environment.reset(options={"trial": good})
    assert infos["trial"].tolist() == [good.id] * 2
    environment.step(np.zeros((2, 3)))
