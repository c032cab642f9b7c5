"""An evaluation from its first reset to the leaderboard, as its agent and as a stranger sees it."""

import hashlib
import json
import struct
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from service_harness import GAS, Agent, RunningService, expect, problem

from wrongturn_networks import load_suite
from wrongturn_protocol import AgentKind, Leaderboard, Metrics


@pytest.fixture(scope="module")
def finished(service: RunningService) -> Iterator[dict[str, Any]]:
    """An evaluation whose every episode was driven, and what was seen on the way."""
    with service.agent(description="drives on", homepage="https://example.org") as agent:
        evaluation = agent.evaluate()
        episodes: dict[str, int] = {}
        order = []
        while (response := agent.reset(evaluation["id"])).status_code == 201:
            reset = response.json()
            assert set(reset) == {"id", "seq", "observation", "lease_expires_in_s", "town"}
            steps, last = agent.drive(reset["id"])
            assert set(last) == {"seq", "observation", "terminated", "truncated"}
            episodes[reset["id"]] = steps
            order.append(reset["id"])
        problem(response, 409, "evaluation-finished")
        yield {"agent": agent, "evaluation": evaluation, "episodes": episodes, "order": order}


def test_what_a_new_evaluation_says(service: RunningService, agent: Agent) -> None:
    evaluation = agent.evaluate("wrong-command@3")
    assert evaluation == {
        "id": evaluation["id"],
        "suite": "wrong-command@3",
        "agent": agent.id,
        "state": "running",
        "trials": 120,
        "finished": 0,
        "max_parallel": 6,
        "commitment": evaluation["commitment"],
        "secret": None,
        "metrics": None,
    }
    assert expect(agent.http.get(f"/v1/evaluations/{evaluation['id']}"), 200) == evaluation


def test_each_trial_and_each_twin_was_driven_once(finished: dict[str, Any]) -> None:
    agent: Agent = finished["agent"]
    detail = expect(agent.http.get(f"/v1/evaluations/{finished['evaluation']['id']}"), 200)
    assert (detail["state"], detail["trials"], detail["finished"]) == ("finished", 12, 12)
    metrics = Metrics.model_validate_json(json.dumps(detail["metrics"]))
    assert metrics.unsafe.trials == 6
    shown = expect(agent.http.get(f"/v1/evaluations/{finished['evaluation']['id']}/episodes"), 200)["episodes"]
    drawn = load_suite("smoke@3").draw(detail["secret"])
    assert {episode["trial"] for episode in shown} == {trial.id for trial in drawn.episodes}
    assert {episode["id"]: episode["seq"] for episode in shown} == finished["episodes"]


def test_finished_episodes_are_shown_to_everybody(
    service: RunningService, finished: dict[str, Any], agent: Agent
) -> None:
    episode = finished["order"][0]
    with httpx.Client(base_url=service.url, timeout=60) as stranger:
        shown = expect(stranger.get(f"/v1/episodes/{episode}"), 200)
        trajectory = stranger.get(f"/v1/episodes/{episode}/trajectory")
    assert shown["outcome"]["verdict"]
    assert shown["trial"].startswith("Town01.")
    assert hashlib.sha256(trajectory.content).hexdigest() == shown["trajectory_sha256"]
    assert expect(agent.http.get(f"/v1/episodes/{episode}"), 200) == shown


def test_the_workers_record(finished: dict[str, Any]) -> None:
    agent: Agent = finished["agent"]
    url = f"/v1/evaluations/{finished['evaluation']['id']}/results"
    record = [
        {
            "episode": episode,
            "steps": steps,
            "actions_sha256": hashlib.sha256(struct.pack("<3f", *GAS.values()) * steps).hexdigest(),
            "latency_ms": 1.5,
        }
        for episode, steps in finished["episodes"].items()
    ]
    for _ in range(2):
        body = {"episodes": record, "versions": {"worker": "1.0"}}
        assert expect(agent.http.put(url, json=body), 200)["state"] == "finished"
    for field, value, path in (
        ("steps", 1, "episodes.2.steps"),
        ("actions_sha256", "0" * 64, "episodes.2.actions_sha256"),
        ("episode", "ep_none", "episodes.2.episode"),
    ):
        wrong = [{**item, field: value} if index == 2 else item for index, item in enumerate(record)]
        problem(agent.http.put(url, json={"episodes": wrong}), 409, "results-mismatch", path)
    problem(agent.http.put(url, json={"episodes": [{**record[0], "latency_ms": -1}]}), 422, "validation")
    twice = [*record, {**record[1], "latency_ms": 2.0}]
    problem(agent.http.put(url, json={"episodes": twice}), 422, "validation", f"episodes.{len(record)}.episode")


def test_a_leaderboard_without_agents_has_algorithms_alone(service: RunningService) -> None:
    with httpx.Client(base_url=service.url, timeout=60) as stranger:
        board = Leaderboard.model_validate_json(stranger.get("/v1/leaderboards/wrong-command@3").text)
    assert {entry.agent.kind for entry in board.entries} == {AgentKind.ALGORITHM}
    assert board.updated is None


def test_nothing_is_told_before_the_end(service: RunningService, agent: Agent, other: Agent) -> None:
    evaluation = agent.evaluate()["id"]
    reset = expect(agent.reset(evaluation), 201)
    assert "trial" not in reset
    agent.drive(reset["id"])
    shown = expect(agent.http.get(f"/v1/episodes/{reset['id']}"), 200)
    assert shown["state"] == "finished"
    assert [shown[name] for name in ("trial", "outcome", "trajectory_sha256", "actions_sha256")] == [None] * 4
    problem(agent.http.get(f"/v1/episodes/{reset['id']}/trajectory"), 409, "episode-not-shown")
    problem(other.http.get(f"/v1/episodes/{reset['id']}"), 403, "forbidden")
    for path in ("", "/episodes"):
        problem(other.http.get(f"/v1/evaluations/{evaluation}{path}"), 403, "forbidden")
    listed = expect(agent.http.get(f"/v1/evaluations/{evaluation}/episodes"), 200)["episodes"]
    assert listed[0]["trial"] is None
    assert expect(agent.http.get(f"/v1/evaluations/{evaluation}"), 200)["metrics"] is None
