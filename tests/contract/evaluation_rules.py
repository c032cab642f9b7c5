"""Rules about evaluations: begun, driven, cancelled, told, and the worker's own record."""

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
        self.evaluations.append(self.begun(agent))

    def begun(self, agent: Agent) -> Evaluation:
        """A new one."""
        told = self.http(agent, "POST", "/v1/evaluations", {"suite": "smoke@2"})
        assert (told.status, told.fields["trials"], told.fields["max_parallel"]) == (201, TRIALS, PARALLEL)
        return Evaluation(told.fields["id"], agent)

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
    def cancel(self, data: st.DataObject) -> None:
        evaluation, agent = self.an_evaluation(data), self.an_agent(data)
        answer = self.http(agent, "DELETE", "/v1/evaluations/{evaluation}", evaluation=evaluation.id)
        if agent is not evaluation.agent:
            assert answer.kind == "forbidden"
        elif evaluation.state == "finished":
            assert answer.kind == "evaluation-finished"
        else:
            assert (answer.status, answer.fields["state"]) == (200, "cancelled")
            self.cancelled(evaluation)

    @precondition(lambda self: self.evaluations)
    @rule(data=st.data(), way=WAYS)
    def cancel_while_an_episode_begins(self, data: st.DataObject, way: Way) -> None:
        """Either may come first, so that nothing of it stays for other rules."""
        agent = self.an_agent(data)
        if self.world.full or self.world.line:
            return
        evaluation = self.begun(agent)
        begun, ended = self.at_once(
            self.answers.call(agent.token, way, "next", evaluation.id, None),
            self.answers.http(agent.token, ("DELETE", "/v1/evaluations/{evaluation}"), {"evaluation": evaluation.id}),
        )
        assert (ended.status, ended.fields["state"]) == (200, "cancelled")
        assert begun.kind in {"", "evaluation-cancelled"}
        path = "/v1/evaluations/{evaluation}/episodes"
        listed = self.http(agent, "GET", path, evaluation=evaluation.id).fields["episodes"]
        assert [found["state"] for found in listed] in ([], ["lost"])
        if not begun.kind:
            assert [found["id"] for found in listed] == [begun.fields["id"]]
            assert self.call(agent, way, "step", begun.fields["id"], 1, 0.0, 0.0, 0.0).kind == "evaluation-cancelled"

    def cancelled(self, evaluation: Evaluation) -> None:
        evaluation.cancelled = True
        for episode in evaluation.episodes:
            if episode.state == "open":
                episode.lose()

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
