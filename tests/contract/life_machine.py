"""The life of agents, evaluations, episodes and leases as a state machine: each rule makes calls, by HTTP or the socket
as it falls, and holds what they come to against the model. What is refused has to leave everything as it was.
"""

import asyncio
import uuid
from typing import Any

from answers import Way
from episode_rules import EpisodeRules
from evaluation_rules import EvaluationRules
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, precondition, rule
from life_model import TRIALS, Agent, Evaluation
from living import PRACTISED, WAYS
from served_app import ABORT_S, RELEASE_S

from wrongturn_protocol import wire

BROKEN: list[tuple[bytes | str, str, int]] = [
    ("text", "text-message", 1003),
    (wire.pack_calls(1, [["look", "ep_1"]])[:-1], "truncated-message", 1007),
    (wire.pack_calls(1, []), "malformed-message", 1007),
    (bytes(wire.LARGEST + 1), "message-too-large", 1009),
]
"""Messages, and what the connection ends with."""
EXPECTED_ERRORS = {"episode invalid", "simulator start failed"}


class Life(EvaluationRules, EpisodeRules):
    """All rules: those of agents, keys, mistakes, silence and ends stand here."""

    @initialize()
    def two_agents(self) -> None:
        for _ in range(2):
            name = uuid.uuid4().hex
            told = self.served.wait(
                self.answers.http("", ("POST", "/v1/agents"), {}, {"name": name, "track": "privileged"})
            )
            assert told.status == 201
            self.agents.append(Agent(told.fields["id"], told.fields["token"]))

    @precondition(lambda self: len(self.world.episodes) > 1)
    @rule(data=st.data())
    def another_token(self, data: st.DataObject) -> None:
        """The old one is nobody's from then on, over an open socket too."""
        agent = self.an_agent(data)
        assert self.call(agent, Way.SOCKET, "look", "none").kind == "unknown-episode"
        told = self.http(agent, "POST", "/v1/agents/{agent}/token", agent=agent.id)
        assert told.status == 201
        old = Agent(agent.id, agent.token)
        agent.token = told.fields["token"]
        assert self.served.wait(self.answers.last_word(old.token)) == ("unauthenticated", 1008)
        assert self.call(old, Way.JSON, "look", "ep_1").kind == "unauthenticated"

    @precondition(lambda self: self.keys)
    @rule(data=st.data())
    def repeat_a_key(self, data: st.DataObject) -> None:
        agent, way, call, answer = data.draw(st.sampled_from(self.keys))
        assert self.call(agent, way, *call) == answer

    @precondition(lambda self: self.keys)
    @rule(data=st.data(), way=WAYS)
    def use_a_key_for_something_else(self, data: st.DataObject, way: Way) -> None:
        agent, _, call, _ = data.draw(st.sampled_from(self.keys))
        other = {**PRACTISED, "seed": 77}
        assert self.call(agent, way, "practise", other, call[2]).kind == "idempotency-key-reused"

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS, name=st.sampled_from(["step", "look", "abort", "next"]))
    def ask_for_what_is_not_there(self, data: st.DataObject, way: Way, name: str) -> None:
        rest: dict[str, tuple[Any, ...]] = {"step": (1, 0.0, 0.0, 0.0), "next": (None,)}
        answer = self.call(self.an_agent(data), way, name, "none", *rest.get(name, ()))
        assert answer.kind == ("unknown-evaluation" if name == "next" else "unknown-episode")

    @precondition(lambda self: len(self.world.open) > 1)
    @rule(data=st.data(), broken=st.sampled_from(BROKEN))
    def break_the_rules_of_the_socket(self, data: st.DataObject, broken: tuple[bytes | str, str, int]) -> None:
        """The connection ends with its name, and nothing that was driven over it."""
        message, *expected = broken
        assert self.served.wait(self.answers.last_word(self.an_agent(data).token, message)) == tuple(expected)

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
        said = [error for error in self.served.errors if error["event"] not in EXPECTED_ERRORS]
        assert not said, said
        self.served.errors.clear()
