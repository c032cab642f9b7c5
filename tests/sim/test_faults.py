import asyncio
import sys
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest

from wrongturn_judge import compute
from wrongturn_networks import draw_trial, faults, load_town
from wrongturn_networks.making import writing_suites
from wrongturn_protocol import (
    Command,
    FaultKind,
    JunctionType,
    Outcome,
    PracticeRequest,
    ProblemType,
    Reaction,
    Track,
    Verdict,
)
from wrongturn_service.catalogue import practice_trial, town_detail
from wrongturn_service.errors import InvalidRequestError
from wrongturn_service.web import words
from wrongturn_sim import Episode, FaultNotApplicableError, WrongturnSimEnv, WrongturnVectorEnv, available_faults


def delivered(episode):
    return [(row.command, row.route_command) for row in episode.trajectory.rows]


def test_a_twin_gets_the_routes_command(make_trial, drive):
    commands = delivered(drive(make_trial(fault="none")))
    assert all(command == route for command, route in commands)
    assert {route for _, route in commands} == {4, int(make_trial(fault="none").route)}


@pytest.mark.parametrize("junction_type", [kind for kind in JunctionType if kind.missing is not None])
def test_infeasible_names_the_missing_direction_in_the_window(junction_type, make_trial, drive):
    town = load_town("junctions")
    approach = next(name for name, arm in town.approaches.items() if arm.type is junction_type)
    trial = make_trial(approach, "infeasible")
    for command, route in delivered(drive(trial)):
        assert command == (4 if route == 4 else int(junction_type.missing))


def test_omission_is_lane_follow_throughout(make_trial, drive):
    commands = delivered(drive(make_trial(fault="omission")))
    assert {command for command, _ in commands} == {4}
    assert {route for _, route in commands} > {4}


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


def test_infeasible_is_refused_where_no_direction_is_missing():
    town = load_town("junctions")
    approach = next(name for name, arm in town.approaches.items() if arm.type is JunctionType.CROSS)
    with pytest.raises(FaultNotApplicableError, match=r"^fault\.kind: infeasible needs .* has all three; take another"):
        Episode(draw_trial(town, approach, FaultKind.INFEASIBLE, 1), Track.STATE)
    assert FaultKind.INFEASIBLE not in faults.faults_at(town, approach)
    assert FaultKind.INFEASIBLE in faults.faults_at(town, "J1-S")


def practise(approach, fault):
    asyncio.run(practice_trial(PracticeRequest(town="junctions", approach=approach, fault=fault)))


@pytest.mark.parametrize("kind", sorted(set(FaultKind) - set(available_faults())))
def test_a_fault_that_is_not_built_is_refused_as_such_everywhere(kind):
    message = f"{kind} is not built yet; take one of none, infeasible, omission"
    with pytest.raises(FaultNotApplicableError, match=message):
        Episode(draw_trial(load_town("junctions"), "J1-S", kind, 1), Track.STATE)
    for approach in (None, "J1-S"):
        for environment in (WrongturnSimEnv, partial(WrongturnVectorEnv, 2)):
            with pytest.raises(FaultNotApplicableError, match=message):
                environment(town="junctions", approach=approach, fault=kind)
    with pytest.raises(InvalidRequestError, match=message) as refused:
        practise("J1-S", kind)
    assert (refused.value.status, refused.value.kind) == (422, ProblemType.FAULT_NOT_APPLICABLE)
    assert [error.path for error in refused.value.errors] == ["fault"]


SUBSTITUTION = """
from wrongturn_networks.faults import CommandFault
from wrongturn_protocol import Command, FaultKind, Reaction


class Substitution(CommandFault):
    kind = FaultKind.SUBSTITUTION
    guide_word = "other than"
    words = "The command names another exit than the route's."
    reactions = (Reaction.EXIT, Reaction.OTHER)

    @classmethod
    def refusal(cls, trial):
        return None if trial.approach.endswith("-S") else "needs the southern arm; take it"

    def deliver(self, t, guidance):
        if guidance.command is Command.LANE_FOLLOW:
            return guidance.command
        return next(direction for direction in guidance.approach.exits if direction is not guidance.command)

    @classmethod
    def reaction(cls, verdict, on_missing_side):
        return Reaction.EXIT if verdict.exited else Reaction.OTHER
"""


@pytest.fixture
def substitution(tmp_path, monkeypatch):
    """A fault that is one file of another package, which names it by an entry point."""
    (tmp_path / "substitution_fault.py").write_text(SUBSTITUTION)
    info = tmp_path / "substitution_fault-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: substitution-fault\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[wrongturn.faults]\nsubstitution = substitution_fault:Substitution\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(faults, "_registry", cache(faults._registry.__wrapped__))
    yield FaultKind.SUBSTITUTION
    del sys.modules["substitution_fault"]


def test_a_new_fault_is_driven_to_its_verdict_and_explained(substitution, make_trial, drive):
    trial = make_trial("J1-S", substitution)
    outcome = drive(trial).outcome
    assert outcome.verdict is Verdict.EXIT_ROUTE
    assert outcome.reaction is Reaction.EXIT
    twin = Outcome(verdict=Verdict.EXIT_COMMANDED, time=1.0, max_deceleration=0.0)
    suite = SimpleNamespace(id="mine@1", trials=(trial,))
    metrics = compute(suite, {trial.id: outcome, trial.twin().id: twin})
    assert metrics.reactions["substitution"] == {Reaction.EXIT: 1, Reaction.OTHER: 0}
    assert metrics.table_strict[trial.junction_type]["substitution"].trials == 1
    assert words.fault("substitution") == "The command names another exit than the route's."
    assert words.told(trial).startswith("The command names another exit than the route's. The route goes ")


def test_practice_and_environments_ask_a_new_fault_where_it_applies(substitution):
    assert substitution in available_faults()
    south = {name for name in load_town("junctions").approaches if name.endswith("-S")}
    assert {one.id for one in town_detail("junctions").approaches if substitution in one.faults} == south
    practise("J1-S", substitution)
    with pytest.raises(InvalidRequestError, match="substitution needs the southern arm"):
        practise("J1-W", substitution)
    env = WrongturnSimEnv("junctions", fault=substitution)
    assert {env.reset(seed=k)[1]["trial"].split(".")[1] for k in range(20)} == south


def test_the_suite_maker_asks_a_new_fault_where_it_applies(substitution, monkeypatch):
    monkeypatch.setattr(writing_suites, "PAPER_FAULTS", (substitution,))
    with pytest.raises(FaultNotApplicableError, match="substitution needs the southern arm"):
        writing_suites.suite_text("wrong-command@2")


def test_episodes_and_batches_deliver_a_new_faults_command(substitution, make_trial, drive):
    trial = make_trial("J1-S", substitution)
    episode = drive(trial)
    exits = {int(direction) for direction in load_town("junctions").approach("J1-S").exits}
    for command, route in delivered(episode):
        assert command == 4 if route == 4 else command in exits - {route}
    assert {route for _, route in delivered(episode)} > {4}
    env = WrongturnVectorEnv(2, trial=trial)
    env.reset(seed=1)
    for row in episode.trajectory.rows[1::2]:
        env.step(np.array([[row.steer, row.throttle, row.brake]] * 2, np.float32))
    assert env.episode(1).trajectory.to_json() == episode.trajectory.to_json()
