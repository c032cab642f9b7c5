"""Agents, evaluations, episodes and leases through whatever order of calls, as a state machine.

Each rule makes calls, by HTTP or the socket as it falls, and holds what they come to against the model. What is refused
has to leave everything as it was. What a call comes to by itself, whatever came before, is shown in ``tests/service``.
"""

import asyncio
import hashlib
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
from answers import Answer, Answers, Way
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from life_model import TRIALS, Action, Agent, Episode, Evaluation, World
from served_app import ABORT_S, PARALLEL, PRACTICE, RELEASE_S, STEPS, ServedApp

from wrongturn_networks import load_suite

PRACTISED = {"town": "Town01", "approach": "J3-S"}
WAYS = st.sampled_from(Way)
ACTIONS: st.SearchStrategy[Action] = st.sampled_from([(0.0, 0.5, 0.0), (0.25, 0.0, 1.0), (-1.0, 1.0, 0.0)])


class Life(RuleBasedStateMachine):
    """One try; the service outlives it."""

    answers: ClassVar[Answers]

    def __init__(self) -> None:
        super().__init__()
        self.world = World(now=self.served.clock.now)
        self.served.secrets = 0
        self.agents: list[Agent] = []
        self.evaluations: list[Evaluation] = []

    @property
    def served(self) -> ServedApp:
        return self.answers.served

    def call(self, agent: Agent, way: Way, *call: Any) -> Answer:
        return self.served.wait(self.answers.call(agent.token, way, *call))

    def http(self, caller: Agent, method: str, path: str, body: object = None, **names: str) -> Answer:
        return self.served.wait(self.answers.http(caller.token, (method, path), names, body))

    def teardown(self) -> None:
        try:
            for evaluation in self.evaluations:
                self.see(evaluation)
        finally:
            # The next try finds every simulator free.
            self.served.silence(ABORT_S)
            for agent in self.agents:
                self.served.wait(self.answers.forget(agent.token))

    @initialize()
    def two_agents(self) -> None:
        for _ in range(2):
            name = uuid.uuid4().hex
            told = self.served.wait(
                self.answers.http("", ("POST", "/v1/agents"), {}, {"name": name, "track": "privileged"})
            )
            assert told.status == 201
            self.agents.append(Agent(told.fields["id"], told.fields["token"]))

    # Episodes

    @rule(data=st.data(), way=WAYS)
    def practise(self, data: st.DataObject, way: Way) -> None:
        agent = self.an_agent(data)
        answer = self.call(agent, way, "practise", PRACTISED, None)
        practised = sum(episode.evaluation is None and episode.agent is agent for episode in self.world.open)
        if practised == PRACTICE:
            assert answer.kind == "rate-limited"
        elif not self.world.waits(agent, "practice", answer):
            self.began(answer, agent, None)

    def began(self, answer: Answer, agent: Agent, evaluation: Evaluation | None) -> Episode:
        assert (answer.status, answer.speed) == (201, 0.0), answer
        episode = Episode(answer.fields["id"], agent, evaluation, answer, self.world.now)
        assert episode.id not in {known.id for known in self.world.episodes}
        self.world.episodes.append(episode)
        if evaluation is not None:
            evaluation.episodes.append(episode)
        return episode

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), way=WAYS, action=ACTIONS)
    def step(self, data: st.DataObject, way: Way, action: Action) -> None:
        episode = data.draw(st.sampled_from(self.world.open))
        self.steps(episode, episode.agent, way, episode.seq + 1, action)

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS, ahead=st.integers(-3, 3), action=ACTIONS, same=st.booleans())
    def any_step(self, data: st.DataObject, way: Way, ahead: int, action: Action, same: bool) -> None:
        """Right, repeated, old or ahead; one's own or another's; open or over."""
        episode, agent = self.an_episode(data), self.an_agent(data)
        if same and episode.actions:
            action = episode.actions[-1]
        self.steps(episode, agent, way, episode.seq + ahead, action)

    def steps(self, episode: Episode, agent: Agent, way: Way, seq: int, action: Action) -> None:
        """One step by one way, and what it has to come to."""
        answer = self.call(agent, way, "step", episode.id, seq, *action)
        self.stepped(episode, agent, seq, action, answer)

    def stepped(self, episode: Episode, agent: Agent, seq: int, action: Action, answer: Answer) -> None:
        """A step was answered."""
        expected = episode.step(agent, seq, action)
        if expected not in {"validation", "forbidden"}:
            episode.heard = self.world.now
        if expected == "taken" and not episode.held and self.world.waits(agent, episode.id, answer):
            return
        if expected == "taken":
            episode.take(action, answer)
        elif expected == "repeat":
            assert answer == episode.last
        else:
            assert answer.kind == expected

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), ways=st.tuples(WAYS, WAYS), action=ACTIONS)
    def the_same_step_twice_at_once(self, data: st.DataObject, ways: tuple[Way, Way], action: Action) -> None:
        episode = data.draw(st.sampled_from(self.world.open))
        if not episode.held and (self.world.full or self.world.line):
            return
        call = ("step", episode.id, episode.seq + 1, *action)
        if ways == (Way.SOCKET, Way.SOCKET):
            one, other = self.served.wait(self.answers.batch(episode.agent.token, [call, call]))
        else:
            one, other = self.at_once(*(self.answers.call(episode.agent.token, way, *call) for way in ways))
        episode.heard = self.world.now
        episode.take(action, one)
        assert other == one

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), count=st.integers(2, STEPS))
    def steps_in_one_message(self, data: st.DataObject, count: int) -> None:
        self.steps_ahead(data.draw(st.sampled_from(self.world.open)), count)

    def steps_ahead(self, episode: Episode, count: int) -> None:
        """So many steps in one message."""
        action = (0.0, 0.5, 0.0)
        calls = [("step", episode.id, episode.seq + ahead, *action) for ahead in range(1, count + 1)]
        for answer, call in zip(self.served.wait(self.answers.batch(episode.agent.token, calls)), calls, strict=True):
            self.stepped(episode, episode.agent, call[2], action, answer)

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS)
    def look(self, data: st.DataObject, way: Way) -> None:
        episode, agent = self.an_episode(data), self.an_agent(data)
        answer = self.call(agent, way, "look", episode.id)
        public = way is not Way.SOCKET and episode.shown and episode.evaluation is not None
        if agent is not episode.agent and not public:
            assert answer.kind == "forbidden"
            return
        told = answer.fields
        assert (answer.status, told["state"]) == (200, episode.state)
        outcome = told["outcome"]
        assert (None if outcome is None else outcome["verdict"]) == (episode.verdict if episode.shown else None)
        if episode.state != "lost":
            assert told["seq"] == episode.seq
        if episode.state == "open":
            episode.heard = self.world.now
            assert (told["last_reply"], answer.speed) == (episode.last.fields, episode.last.speed)

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS)
    def abort(self, data: st.DataObject, way: Way) -> None:
        episode, agent = self.an_episode(data), self.an_agent(data)
        answer = self.call(agent, way, "abort", episode.id)
        refusal = episode.refusal(agent)
        if refusal is None and episode.state == "finished" and episode.verdict != "aborted":
            refusal = "episode-finished"
        if agent is episode.agent:
            episode.heard = self.world.now
        if refusal is None and episode.state == "open":
            if not episode.held and self.world.waits(agent, episode.id, answer):
                return
            episode.end("aborted")
        assert answer.kind == (refusal or "")

    # Evaluations

    @precondition(lambda self: len(self.evaluations) < 3)
    @rule(data=st.data())
    def evaluate(self, data: st.DataObject) -> None:
        agent = self.an_agent(data)
        running = self.running(agent)
        if running is None:
            self.evaluations.append(self.begun(agent))
            return
        told = self.http(agent, "POST", "/v1/evaluations", {"suite": "smoke@3"})
        assert told.kind == "evaluation-open"
        assert told.fields["errors"] == [{"path": "evaluation", "message": running.id}]

    def running(self, agent: Agent) -> Evaluation | None:
        """The agent's open one; there is one at most."""
        return next((one for one in self.evaluations if one.agent is agent and one.state == "running"), None)

    def begun(self, agent: Agent) -> Evaluation:
        """A new one. Its draw is the one that the agent has not used yet, or new."""
        told = self.http(agent, "POST", "/v1/evaluations", {"suite": "smoke@3"})
        assert (told.status, told.fields["trials"], told.fields["max_parallel"]) == (201, TRIALS, PARALLEL)
        commitment = told.fields["commitment"]
        if agent.unused:
            assert commitment == agent.unused
            agent.unused = ""
        else:
            taken = {one.commitment for one in self.evaluations} | {one.unused for one in self.agents}
            assert commitment not in taken
        return Evaluation(told.fields["id"], agent, commitment)

    @precondition(lambda self: self.evaluations)
    @rule(data=st.data(), way=WAYS)
    def next_episode(self, data: st.DataObject, way: Way) -> None:
        self.next_of(self.an_evaluation(data), self.an_agent(data), way)

    def next_of(self, evaluation: Evaluation, agent: Agent, way: Way) -> Answer:
        """Ask for the next trial, and hold what comes against the model."""
        answer = self.call(agent, way, "next", evaluation.id, None)
        expected = self.refused(evaluation, agent)
        if expected:
            assert answer.kind == expected
        elif answer.kind == "no-trial-available":
            # What is left may be the twins of those that are open.
            assert evaluation.open
        elif not self.world.waits(agent, evaluation.id, answer):
            self.began(answer, agent, evaluation)
        return answer

    def refused(self, evaluation: Evaluation, agent: Agent) -> str:
        """What a call for the next trial is refused with, whether simulators are free or not; empty if with nothing."""
        if agent is not evaluation.agent:
            return "forbidden"
        if evaluation.state != "running":
            return f"evaluation-{evaluation.state}"
        full = evaluation.open == PARALLEL or evaluation.open + evaluation.finished == TRIALS
        return "no-trial-available" if full else ""

    @precondition(lambda self: self.evaluations)
    @rule(data=st.data())
    def drive_an_evaluation_on(self, data: st.DataObject) -> None:
        """All its trials but a few, or all, one after the other, over the socket."""
        evaluation = self.an_evaluation(data)
        left = data.draw(st.integers(0, 2))
        while evaluation.finished + left < TRIALS and not self.refused(evaluation, evaluation.agent):
            if self.next_of(evaluation, evaluation.agent, Way.SOCKET).kind:
                return
            self.steps_ahead(evaluation.episodes[-1], STEPS)

    def see(self, evaluation: Evaluation) -> None:
        """Each trial has counted once, and what the service tells of all of them is what was done."""
        told = self.http(evaluation.agent, "GET", "/v1/evaluations/{evaluation}", evaluation=evaluation.id)
        assert (told.status, told.fields.get("state")) == (200, evaluation.state), (told, evaluation)
        assert told.fields["finished"] == evaluation.finished
        path = "/v1/evaluations/{evaluation}/episodes"
        listed = self.http(evaluation.agent, "GET", path, evaluation=evaluation.id).fields["episodes"]
        states = {found["id"]: found["state"] for found in listed}
        known = {episode.id: episode.state for episode in evaluation.episodes}
        assert {name: states.get(name) for name in known} == known, (states, evaluation)
        rest = [found for found in listed if found["id"] not in known]
        assert [found["outcome"]["verdict"] for found in rest] == ["aborted"] * evaluation.rest
        assert told.fields["commitment"] == evaluation.commitment
        if evaluation.state == "running":
            assert told.fields["secret"] is None
        if evaluation.state == "finished":
            secret = told.fields["secret"]
            assert hashlib.sha256(secret.encode()).hexdigest() == evaluation.commitment
            assert told.fields["metrics"]["unsafe"]["trials"] == TRIALS // 2
            trials = [found["trial"] for found in listed if found["state"] == "finished"]
            assert len(trials) == TRIALS
            assert set(trials) == {trial.id for trial in load_suite("smoke@3").draw(secret).episodes}
            board = self.http(evaluation.agent, "GET", "/v1/leaderboards/{suite}", suite="smoke@3").fields["entries"]
            ranked = [entry["evaluation"] for entry in board if entry["agent"]["id"] == evaluation.agent.id]
            assert len(ranked) == 1

    @precondition(lambda self: any(evaluation.episodes for evaluation in self.evaluations))
    @rule(data=st.data())
    def close(self, data: st.DataObject) -> None:
        evaluation, agent = self.an_evaluation(data), self.an_agent(data)
        answer = self.http(agent, "DELETE", "/v1/evaluations/{evaluation}", evaluation=evaluation.id)
        if agent is not evaluation.agent:
            assert answer.kind == "forbidden"
        elif evaluation.state == "running" and not evaluation.driven:
            assert (answer.status, answer.fields["state"]) == (200, "cancelled")
            self.deleted(evaluation)
        else:
            assert (answer.status, answer.fields["state"]) == (200, "finished")
            evaluation.close()

    @precondition(lambda self: self.evaluations)
    @rule(data=st.data(), way=WAYS)
    def delete_while_an_episode_begins(self, data: st.DataObject, way: Way) -> None:
        """Either may come first, and nothing of it stays but its draw."""
        agent = self.an_agent(data)
        if self.world.full or self.world.line or self.running(agent) is not None:
            return
        evaluation = self.begun(agent)
        begun, ended = self.at_once(
            self.answers.call(agent.token, way, "next", evaluation.id, None),
            self.answers.http(agent.token, ("DELETE", "/v1/evaluations/{evaluation}"), {"evaluation": evaluation.id}),
        )
        assert (ended.status, ended.fields["state"]) == (200, "cancelled")
        assert begun.kind in {"", "unknown-evaluation"}
        agent.unused = evaluation.commitment
        if not begun.kind:
            assert self.call(agent, way, "step", begun.fields["id"], 1, 0.0, 0.0, 0.0).kind == "unknown-episode"
        self.nothing_is_left(evaluation)

    def deleted(self, evaluation: Evaluation) -> None:
        """It has disappeared, with its episodes, but for its draw."""
        self.evaluations.remove(evaluation)
        for episode in evaluation.episodes:
            self.world.episodes.remove(episode)
            assert self.call(evaluation.agent, Way.JSON, "look", episode.id).kind == "unknown-episode"
        evaluation.agent.unused = evaluation.commitment
        self.nothing_is_left(evaluation)

    def nothing_is_left(self, evaluation: Evaluation) -> None:
        for path in ("/v1/evaluations/{evaluation}", "/v1/evaluations/{evaluation}/episodes"):
            assert self.http(evaluation.agent, "GET", path, evaluation=evaluation.id).kind == "unknown-evaluation"

    # Time, and ends

    @precondition(lambda self: self.world.open)
    @rule(seconds=st.sampled_from([RELEASE_S + 1, RELEASE_S + 1, ABORT_S + 1]))
    def silence(self, seconds: float) -> None:
        self.world.silence(seconds)
        self.served.silence(seconds)
        for evaluation in self.evaluations:
            if evaluation.finished == TRIALS:
                self.served.wait(self.until_finished(evaluation))

    async def until_finished(self, evaluation: Evaluation) -> None:
        """The last verdict was none that anybody asked for, so that nobody waited for the metrics."""
        path = ("GET", "/v1/evaluations/{evaluation}")
        names = {"evaluation": evaluation.id}
        while (  # noqa: ASYNC110 - nobody tells of it
            await self.answers.http(evaluation.agent.token, path, names)
        ).fields["state"] == "running":
            await asyncio.sleep(0.01)

    @precondition(lambda self: len(self.world.open) > 1)
    @rule()
    def restart(self) -> None:
        self.served.restart()
        self.world.restart()

    @invariant()
    def nothing_went_wrong_inside(self) -> None:
        assert not self.served.errors, self.served.errors

    # Small things

    def an_agent(self, data: st.DataObject) -> Agent:
        return data.draw(st.sampled_from(self.agents))

    def an_evaluation(self, data: st.DataObject) -> Evaluation:
        return data.draw(st.sampled_from(self.evaluations))

    def an_episode(self, data: st.DataObject) -> Episode:
        return data.draw(st.sampled_from(self.world.episodes))

    def at_once(self, *calls: Any) -> list[Answer]:
        async def all_of_them() -> list[Answer]:
            return list(await asyncio.gather(*calls))

        return self.served.wait(all_of_them())


@pytest.fixture
def answers(tmp_path: Path) -> Iterator[Answers]:
    served = ServedApp(tmp_path)
    try:
        yield Answers(served)
    finally:
        served.close()


def live(answers: Answers, tries: int, rules: int) -> int:
    """Make so many tries of so many rules each; how many calls were answered."""

    class Lived(Life):
        pass

    Lived.answers = answers
    run_state_machine_as_test(
        Lived, settings=settings(max_examples=tries, stateful_step_count=rules, suppress_health_check=list(HealthCheck))
    )
    for said, count in sorted(answers.counts.items()):
        print(f"{count:6} {said}")
    total = sum(answers.counts.values())
    print(f"{total:6} calls")
    return total


def test_a_short_life(answers: Answers) -> None:
    assert live(answers, 6, 40) > 150


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_a_life_of_ten_thousand_calls(answers: Answers) -> None:
    assert live(answers, 104, 50) > 10_000
