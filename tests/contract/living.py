"""What the rules of the state machine share: the world as the model has it, and how calls are made of it."""

import asyncio
import hashlib
from typing import Any, ClassVar

from answers import Answer, Answers, Way
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine
from life_model import TRIALS, Action, Agent, Episode, Evaluation, World
from served_app import ABORT_S, ServedApp

from wrongturn_networks import load_suite

PRACTISED = {"town": "Town01", "approach": "J3-S"}
WAYS = st.sampled_from(Way)
ACTIONS: st.SearchStrategy[Action] = st.sampled_from([(0.0, 0.5, 0.0), (0.25, 0.0, 1.0), (-1.0, 1.0, 0.0)])


class Living(RuleBasedStateMachine):
    """One try; the service outlives it."""

    answers: ClassVar[Answers]

    def __init__(self) -> None:
        super().__init__()
        self.world = World(now=self.served.clock.now)
        self.served.secrets = 0
        self.agents: list[Agent] = []
        self.evaluations: list[Evaluation] = []
        self.keys: list[tuple[Agent, Way, tuple[Any, ...], Answer]] = []

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

    def began(self, answer: Answer, agent: Agent, evaluation: Evaluation | None) -> Episode:
        assert (answer.status, answer.speed) == (201, 0.0), answer
        episode = Episode(answer.fields["id"], agent, evaluation, answer, self.world.now)
        assert episode.id not in {known.id for known in self.world.episodes}
        self.world.episodes.append(episode)
        if evaluation is not None:
            evaluation.episodes.append(episode)
        return episode

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

    def steps_ahead(self, episode: Episode, count: int) -> None:
        """So many steps in one message."""
        action = (0.0, 0.5, 0.0)
        calls = [("step", episode.id, episode.seq + ahead, *action) for ahead in range(1, count + 1)]
        for answer, call in zip(self.served.wait(self.answers.batch(episode.agent.token, calls)), calls, strict=True):
            self.stepped(episode, episode.agent, call[2], action, answer)

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
            assert set(trials) == {trial.id for trial in load_suite("smoke@2").draw(secret).episodes}
            board = self.http(evaluation.agent, "GET", "/v1/leaderboards/{suite}", suite="smoke@2").fields["entries"]
            ranked = [entry["evaluation"] for entry in board if entry["agent"]["id"] == evaluation.agent.id]
            assert len(ranked) == 1

    # Small things

    def an_agent(self, data: st.DataObject) -> Agent:
        return data.draw(st.sampled_from(self.agents))

    def an_evaluation(self, data: st.DataObject) -> Evaluation:
        return data.draw(st.sampled_from(self.evaluations))

    def an_episode(self, data: st.DataObject) -> Episode:
        return data.draw(st.sampled_from(self.world.episodes))

    def practised(self, agent: Agent) -> int:
        return sum(episode.evaluation is None and episode.agent is agent for episode in self.world.open)

    def at_once(self, *calls: Any) -> list[Answer]:
        async def all_of_them() -> list[Answer]:
            return list(await asyncio.gather(*calls))

        return self.served.wait(all_of_them())
