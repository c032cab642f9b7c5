"""Rules about evaluations: begun, driven, closed, told, and the worker's own record."""

import uuid

from answers import Answer, Way
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule
from life_model import TRIALS, Agent, Evaluation
from living import WAYS, Living
from served_app import PARALLEL, STEPS


class EvaluationRules(Living):
    """Each holds one call on an evaluation against the model, or several at once."""

    @precondition(lambda self: len(self.evaluations) < 3)
    @rule(data=st.data())
    def evaluate(self, data: st.DataObject) -> None:
        agent = self.an_agent(data)
        running = self.running(agent)
        if running is None:
            self.evaluations.append(self.begun(agent))
            return
        told = self.http(agent, "POST", "/v1/evaluations", {"suite": "smoke@2"})
        assert told.kind == "evaluation-open"
        assert told.fields["errors"] == [{"path": "evaluation", "message": running.id}]

    def running(self, agent: Agent) -> Evaluation | None:
        """The agent's open one; there is one at most."""
        return next((one for one in self.evaluations if one.agent is agent and one.state == "running"), None)

    def begun(self, agent: Agent) -> Evaluation:
        """A new one. Its draw is the one that the agent has not used yet, or new."""
        told = self.http(agent, "POST", "/v1/evaluations", {"suite": "smoke@2"})
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
    @rule(data=st.data(), way=WAYS, keyed=st.booleans())
    def next_episode(self, data: st.DataObject, way: Way, keyed: bool) -> None:
        evaluation, agent = self.an_evaluation(data), self.an_agent(data)
        key = uuid.uuid4().hex if keyed else None
        answer = self.next_of(evaluation, agent, way, key)
        if keyed and answer.status == 201:
            self.keys.append((agent, way, ("next", evaluation.id, key), answer))

    def next_of(self, evaluation: Evaluation, agent: Agent, way: Way, key: str | None = None) -> Answer:
        """Ask for the next trial, and hold what comes against the model."""
        answer = self.call(agent, way, "next", evaluation.id, key)
        expected = self.refused(evaluation, agent)
        if expected:
            assert answer.kind == expected
        elif answer.kind == "no-trial-available":
            # What is left may be the twins of those that are open.
            assert evaluation.open
        elif not self.world.waits(agent, f"{evaluation.id} {key}", answer):
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

    @precondition(lambda self: self.evaluations)
    @rule(data=st.data())
    def progress(self, data: st.DataObject) -> None:
        self.see(self.an_evaluation(data))

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

    @precondition(lambda self: self.evaluations)
    @rule(data=st.data(), mistake=st.sampled_from(["", "", "steps", "actions_sha256", "twice", "unknown"]))
    def put_results(self, data: st.DataObject, mistake: str) -> None:
        evaluation, agent = self.an_evaluation(data), self.an_agent(data)
        record = [
            {
                "episode": episode.id,
                "steps": episode.seq + (mistake == "steps"),
                "actions_sha256": "0" * 64 if mistake == "actions_sha256" else episode.sha256,
            }
            for episode in evaluation.episodes
            if episode.state == "finished"
        ]
        expected = "results-mismatch" if mistake and record else ""
        if mistake == "twice" and record:
            expected = "validation"
            record.append(record[0])
        if mistake == "unknown":
            expected = "results-mismatch"
            record.append({"episode": "ep_none", "steps": 0, "actions_sha256": "0" * 64})
        if agent is not evaluation.agent:
            expected = "validation" if expected == "validation" else "forbidden"
        path = "/v1/evaluations/{evaluation}/results"
        answer = self.http(agent, "PUT", path, {"episodes": record}, evaluation=evaluation.id)
        assert answer.kind == expected
