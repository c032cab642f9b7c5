import math

import numpy as np
import pytest

from wrongturn_networks import draw_journey, load_town
from wrongturn_protocol import Command, Task
from wrongturn_sim.polyline import Polyline, project
from wrongturn_sim.route import Navigator, start_pose


def passage(town, approach_id, direction):
    """Points 0.1 m apart through a junction with their distances; those of the stop line and the exit line."""
    approach = town.approach(approach_id)
    lines = [town.lanes[approach.lane].centreline, approach.exits[direction].path]
    whole = Polyline(np.concatenate([*lines, town.lanes[approach.exits[direction].lane].centreline]))
    stop, exit_line = Polyline(lines[0]).length, Polyline(np.concatenate(lines)).length
    # Not into the window of the next junction, where the streets are short.
    s = np.arange(max(0.0, stop - 25.0), exit_line + min(9.0, whole.length - exit_line - 15.3), 0.1)
    x = np.interp(s, whole.along, whole.points[:, 0])
    y = np.interp(s, whole.along, whole.points[:, 1])
    return zip(s.tolist(), x.tolist(), y.tolist(), strict=True), stop, exit_line


@pytest.mark.parametrize("town_name", ["junctions", "Town01", "Town02"])
def test_the_command_is_named_in_the_nominal_window_on_every_approach(town_name, make_trial):
    town = load_town(town_name)
    any_trial = make_trial(town=town_name)
    for approach in town.approaches.values():
        for route in approach.exits:
            trial = any_trial.model_copy(
                update={"approach": approach.id, "junction_type": approach.type, "route": route}
            )
            for taken in approach.exits:
                navigator = Navigator(town, trial)
                points, stop, exit_line = passage(town, approach.id, taken)
                for s, x, y in points:
                    guidance = navigator.update(x, y)
                    inside = stop - 15.0 <= s <= exit_line + 5.0
                    near = min(abs(s - stop + 15.0), abs(s - exit_line - 5.0)) < 0.25
                    expected = route if inside else Command.LANE_FOLLOW
                    assert near or guidance.command is expected, (approach.id, route, taken, s - stop, s - exit_line)
                    here = guidance.within()
                    assert (here is not None) == (guidance.command is not Command.LANE_FOLLOW)
                    if here is not None and not near:
                        assert here[:2] == (route, frozenset(approach.exits))
                        assert here.first
                    if taken is route and not near:
                        assert abs(guidance.lateral) < 0.3
                        along = (stop - s, exit_line - s)
                        assert here is None or here[2:4] == pytest.approx(along, abs=0.5)


@pytest.mark.parametrize("window", [10.0, 17.3, 20.0])
def test_a_trials_own_window_moves_its_beginning_and_nothing_else(window, make_trial):
    town = load_town("Town01")
    for approach in town.approaches.values():
        for route in approach.exits:
            nominal = make_trial(approach.id, town="Town01", route=route)
            guides = [Navigator(town, nominal), Navigator(town, nominal.model_copy(update={"window": window}))]
            points, stop, exit_line = passage(town, approach.id, route)
            for s, x, y in points:
                if s > exit_line + 5.0:
                    break
                usual, moved = (navigator.update(x, y) for navigator in guides)
                assert moved.lateral == usual.lateral
                assert moved.heading == usual.heading
                assert guides[1].stop_line == guides[0].stop_line
                assert (moved.window, moved[2:4]) == (window, usual[2:4])
                if abs(s - stop + window) > 0.25 and abs(s - exit_line - 5.0) > 0.25:
                    assert moved.command is (route if s > stop - window else Command.LANE_FOLLOW)


def test_the_route_goes_on_by_the_trials_seed_and_no_other_draw(make_trial):
    town = load_town("Town01")
    onward = set()
    for seed in range(12):
        trial = make_trial("J3-S" if "J3-S" in town.approaches else min(town.approaches), town="Town01", seed=seed)
        seen = []
        for _ in range(2):
            navigator = Navigator(town, trial)
            points, *_ = passage(town, trial.approach, trial.route)
            for _, x, y in points:
                navigator.update(x, y)
            exit_lane = town.lanes[town.approach(trial.approach).exits[trial.route].lane]
            x, y = np.asarray(exit_lane.centreline)[-1]
            seen.append(navigator.update(float(x), float(y)).command)
        assert seen[0] is seen[1]
        onward.add(seen[0])
    assert len(onward) > 1


def test_a_lane_that_leads_nowhere_is_followed(make_trial):
    town = load_town("junctions")
    dead = [
        (approach, exit_)
        for approach in town.approaches.values()
        for exit_ in approach.exits.values()
        if town.approach_of_lane(exit_.lane) is None
    ]
    assert dead, "the small town's arms end"
    approach, exit_ = dead[0]
    navigator = Navigator(town, make_trial(approach.id, route=exit_.direction))
    points, *_ = passage(town, approach.id, exit_.direction)
    for _, x, y in points:
        guidance = navigator.update(x, y)
    assert guidance.command is Command.LANE_FOLLOW
    assert guidance.ahead is None
    assert guidance.last is not None
    assert guidance.last.route is exit_.direction
    assert navigator.stop_line == -1.0
    exits, mask = navigator.exits()
    assert not exits.any()
    assert not mask.any()
    end = np.asarray(town.lanes[exit_.lane].centreline)[-1]
    assert navigator.lane_ahead()[-1] == pytest.approx(end, abs=1e-3) or math.dist((x, y), end) > 59
    navigator.update(*map(float, end + 30.0))


@pytest.mark.parametrize("town_name", ["Town01", "Town02"])
def test_a_journey_is_planned_anew_from_wherever_the_car_comes_back_to_a_lane(town_name):
    town = load_town(town_name)
    journey = draw_journey(town, Task.NAVIGATION, 1)
    approach = town.approach(journey.approach)
    late = [(way.lane, 40.0) for way in approach.exits.values() if town.lanes[way.lane].length > 50.0]
    assert late
    for lane, after in [*late, (town.lanes[approach.lane].opposite, 6.0)]:
        path = Polyline(town.lanes[lane].centreline)
        for trial, expected in ((journey, lane), (journey.model_copy(update={"journey": None}), approach.lane)):
            navigator = Navigator(town, trial)
            points, _, _ = passage(town, approach.id, trial.route)
            for s, x, y in points:
                if s > Polyline(town.lanes[approach.lane].centreline).length + 1.0:
                    break
                navigator.update(x, y)
            # Into an exit's lane farther on than where exits are taken, or round to the own street's other lane.
            for s in np.arange(after - 5.0, after + 3.0, 0.5):
                x, y = (float(np.interp(s, path.along, path.points[:, k])) for k in (0, 1))
                guidance = navigator.update(x, y)
            assert navigator.lane == expected
            if expected == lane:
                assert abs(guidance.lateral) < 0.1
                assert guidance.ahead.exits == frozenset(town.approach_of_lane(lane).exits)
                assert guidance.last is None


def test_the_start_is_where_the_trial_says(make_trial):
    for town_name in ("junctions", "Town01"):
        town = load_town(town_name)
        for seed, name in enumerate(town.approaches):
            trial = make_trial(name, town=town_name, seed=seed)
            pose = start_pose(town, trial)
            lane = Polyline(town.lanes[town.approach(name).lane].centreline)
            s, lateral, heading = project(lane.points, lane.along, 0, len(lane.points), pose.x, pose.y)
            assert lane.length - s == pytest.approx(trial.start.distance, abs=0.1)
            assert lateral == pytest.approx(trial.start.lateral, abs=0.02)
            assert math.remainder(pose.yaw - heading, math.tau) == pytest.approx(trial.start.yaw, abs=0.05)
