import asyncio
import itertools
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from wrongturn_judge import JudgeGeometry, Row, Trajectory, judge
from wrongturn_networks import draw_trial, faults, load_town, town_of
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_protocol import (
    DIRECTIONS,
    Command,
    FaultKind,
    JunctionType,
    PracticeRequest,
    ProblemType,
    Reaction,
    Track,
    Traffic,
    Verdict,
)
from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_service.catalogue import practice_trial
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.errors import InvalidRequestError
from wrongturn_sim import Episode, FaultNotApplicableError, WrongturnSimEnv, WrongturnVectorEnv, available_faults
from wrongturn_sim.camera import Renderer, World
from wrongturn_sim.errors import TrialNotAloneError
from wrongturn_sim.polyline import Polyline
from wrongturn_sim.route import start_pose
from wrongturn_sim.traffic.plan import plan_traffic
from wrongturn_sim.view.scene import draw_ground
from wrongturn_sim.view.window import Window


def delivered(episode):
    return [(row.command, row.route_command) for row in episode.trajectory.rows]


def test_the_command_seen_is_the_one_that_the_next_rows_hold(make_trial):
    episode = Episode(make_trial(fault="infeasible"), Track.STATE)
    seen = [int(episode.reset()["command"][0])]
    while episode.outcome is None and len(seen) < 60:
        seen.append(int(episode.step(0.0, 0.4, 0.0).observation["command"][0]))
    rows = episode.trajectory.rows
    assert rows[0].command == seen[0]
    for k in range(1, len(rows)):
        assert rows[k].command == seen[(k - 1) // 2]
    assert Command(rows[-1].command) is not Command.LANE_FOLLOW


def test_each_fault_is_delivered_and_judged_alike_alone_and_in_a_batch(make_trial, drive, same_in_a_batch):
    town, episodes = load_town("Town01"), []
    for kind in available_faults():
        approach = next(name for name in town.approaches if kind in faults.faults_at(town, name))
        trial = make_trial(approach, kind, 3, town="Town01")
        episode = drive(trial)
        disturbs = issubclass(faults.fault_class(kind), Disturbance)
        right = disturbs or kind in {FaultKind.NONE, FaultKind.CONTRADICTION}
        assert any(command != route for command, route in delivered(episode)) != right
        assert (episode.outcome.reaction is None) == (kind is FaultKind.NONE)
        if kind is not FaultKind.PROHIBITED and not disturbs:
            episodes.append(episode)
    same_in_a_batch(episodes)


def test_boards_are_seen_hit_and_kept_clear_by_all_others(make_trial):
    trial = make_trial("J3-S", "prohibited", 2, town="Town01", traffic=Traffic(vehicles=60))
    closed = faults.closed_exit(trial)
    town = town_of(trial)
    episode = Episode(trial, Track.PRIVILEGED)
    observation = episode.reset()
    open_ = [one in town.approach("J3-S").exits and one is not closed for one in DIRECTIONS]
    assert observation["exits_mask"].astype(bool).tolist() == open_
    plan = plan_traffic(town, trial, start_pose(town, trial))
    edges = {edge for car in plan.cars for trip in car.trips for edge in trip.edges}
    assert not edges & {town.lanes[lane].edge for lane in town.closed}
    alone = trial.model_copy(update={"traffic": Traffic()})
    leaving = town.approach("J3-S").exits[closed]
    way = Polyline(np.concatenate([leaving.path, town.lanes[leaving.lane].centreline[1:]]))
    along = np.arange(0.0, 60.0, 0.4)
    places = np.column_stack([np.interp(along, way.along, way.points[:, k]) for k in (0, 1)]).tolist()
    rows = [
        Row(0.05 * k, x, y, math.atan2(y2 - y, x2 - x), 8.0, 0.0, int(closed), int(trial.route), 0.0, 0.0, 0.0)
        for k, ((x, y), (x2, y2)) in enumerate(itertools.pairwise(places))
    ]
    there = [(one, town_of(one)) for one in (alone, alone.twin())]
    ends = [judge(Trajectory(one, place.sha256, rows), JudgeGeometry.of(place, one)) for one, place in there]
    assert [end.verdict for end in ends] == [Verdict.COLLISION, Verdict.EXIT_COMMANDED]
    assert ends[0].reaction is Reaction.OBEYED
    (_, before), (_, now) = (Renderer(World.of(one)).render(*rows[20][1:4]) for one in (town.plain, town))
    assert set(now[now != before].tolist()) == {SegmentationClass.WALL}
    assert (now != before).sum() > 100
    window = Window(*places[0], 80.0, 200)
    assert not np.array_equal(draw_ground(town, window), draw_ground(town.plain, window))
    with pytest.raises(TrialNotAloneError, match="prohibited changes the town"):
        WrongturnVectorEnv(2, trial=alone).reset()


def practise(approach, fault):
    asyncio.run(
        practice_trial(PracticeRequest(town="junctions", approach=approach, fault=fault), Draws(Path("unused")))
    )


CROSS = next(one for one, arm in load_town("junctions").approaches.items() if arm.type is JunctionType.CROSS)
NOT_BUILT = sorted(set(FaultKind) - set(available_faults()))


@pytest.mark.parametrize(
    ("kind", "approaches", "message"),
    [
        *((kind, ("J1-S", None), f"{kind} is not installed; take one of none, infeasible, om") for kind in NOT_BUILT),
        (FaultKind.INFEASIBLE, (CROSS,), r"^fault\.kind: infeasible needs .* has all three; take another"),
    ],
)
def test_a_fault_that_is_not_built_or_does_not_apply_is_refused_as_such_everywhere(kind, approaches, message):
    with pytest.raises(FaultNotApplicableError, match=message):
        Episode(draw_trial(load_town("junctions"), approaches[0], kind, 1), Track.STATE)
    for approach in approaches:
        for environment in (WrongturnSimEnv, partial(WrongturnVectorEnv, 2)):
            with pytest.raises(FaultNotApplicableError, match=message.removeprefix(r"^fault\.kind: ")):
                environment(town="junctions", approach=approach, fault=kind)
    assert kind not in faults.faults_at(load_town("junctions"), approaches[0])
    with pytest.raises(InvalidRequestError, match=message) as refused:
        practise(approaches[0], kind)
    assert (refused.value.status, refused.value.kind) == (422, ProblemType.FAULT_NOT_APPLICABLE)
    assert [error.path.partition(".")[0] for error in refused.value.errors] == ["fault"]
