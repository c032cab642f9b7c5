"""Forks over the service: the original commands up to the fork, the other one from then on, and what is refused."""

import json

from service_harness import COAST, Agent, expect, problem

LEFT, STRAIGHT = 1, 3


def fork(agent: Agent, episode: str, at: float, command: int | None = None) -> dict:
    body = {"episode": episode, "at": at} | ({} if command is None else {"command": command})
    return expect(agent.http.post("/v1/whatifs", json=body), 201)


def finished(agent: Agent, **fields: object) -> tuple[str, int]:
    episode = agent.practise(fault="omission", approach="J3-S", **fields)["id"]
    return episode, agent.drive(episode)[0]


def test_a_fork_is_driven_by_the_ordinary_steps(agent: Agent) -> None:
    episode, steps = finished(agent)
    begun = fork(agent, episode, 1.95, LEFT)
    assert (begun["seq"], begun["trial"]) == (0, "Town01.J3-S.omission.s3")
    for seq in range(1, 25):
        told = expect(agent.step(begun["id"], seq), 200)["observation"]["command"]
        assert told == (LEFT if seq >= 20 else 4), seq
    last, reply = agent.drive(begun["id"], begin=25)
    shown = expect(agent.http.get(f"/v1/episodes/{begun['id']}"), 200)
    assert (shown["origin"], shown["evaluation"]) == (episode, None)
    assert shown["trial_detail"]["fork"] == {"decision": 20, "command": LEFT}
    assert shown["outcome"]["verdict"] == reply["verdict"]
    was, now = (json.loads(agent.trajectory(one)) for one in (episode, begun["id"]))
    # The car goes straight ahead, whatever it is told.
    assert (steps, was["x"], was["y"]) == (last, now["x"], now["y"])
    assert now["command"] == was["command"][:41] + [LEFT] * (len(was["command"]) - 41)
    assert "origin" not in expect(agent.http.get(f"/v1/episodes/{episode}"), 200)
    problem(agent.http.post("/v1/whatifs", json={"episode": begun["id"], "at": 1}), 422, "validation", "episode")


def test_the_command_that_was_right_gives_the_episode_itself(agent: Agent) -> None:
    episode = agent.practise(fault="none")["id"]
    agent.drive(episode)
    send = {"json": {"episode": episode, "at": 0.7}, "headers": {"Idempotency-Key": "what if"}}
    begun, same = (expect(agent.http.post("/v1/whatifs", **send), 201) for _ in range(2))
    assert begun == same
    again = begun["id"]
    agent.drive(again)
    was, now = (json.loads(agent.trajectory(one)) for one in (episode, again))
    assert now.pop("fork") == {"decision": 7, "command": None}
    assert now == was


def test_another_action_before_the_fork_is_refused(agent: Agent) -> None:
    episode, _ = finished(agent)
    begun = fork(agent, episode, 0.2, STRAIGHT)["id"]
    expect(agent.step(begun, 1), 200)
    told = problem(agent.step(begun, 2, COAST), 409, "action-mismatch")["detail"]
    assert "is not deterministic: at step 2, before the fork" in told
    expect(agent.step(begun, 2), 200)
    expect(agent.step(begun, 3, COAST), 200)


def test_bad_requests(agent: Agent, other: Agent) -> None:
    episode, steps = finished(agent)

    def refused(status: int, kind: str, path: str | None = None, by: Agent = agent, **fields: object) -> str:
        body = {"episode": episode, "at": 1.0, **fields}
        return problem(by.http.post("/v1/whatifs", json=body), status, kind, path)["detail"]

    refused(404, "unknown-episode", episode="ep_1")
    refused(403, "forbidden", by=other)
    assert f"the last decision is at {(steps - 1) / 10:.1f} s" in refused(422, "validation", "at", at=steps / 10)
    refused(422, "validation", "at", at=-1)
    refused(422, "validation", "command", command=7)
    refused(422, "validation", "commands", commands=1)
    refused(409, "episode-not-shown", episode=agent.practise()["id"])
    evaluation = agent.evaluate()["id"]
    scored = expect(agent.reset(evaluation), 201)["id"]
    agent.drive(scored)
    refused(409, "episode-not-shown", episode=scored)
    expect(agent.http.delete(f"/v1/evaluations/{evaluation}"), 200)
    # Finished now: it can be forked, and what is shown of it is shown of the fork too.
    begun = fork(agent, scored, 0.3)["id"]
    anybody = other.http
    problem(anybody.get(f"/v1/episodes/{begun}/trajectory"), 403, "forbidden")
    agent.drive(begun)
    assert anybody.get(f"/v1/episodes/{begun}/camera/0").status_code == 200
    del anybody.headers["Authorization"]
    assert anybody.get(f"/v1/episodes/{begun}/camera/0").status_code == 200
    assert begun in anybody.get(f"/episodes/{scored}").text
    assert anybody.get(f"/episodes/{begun}/drive.json").status_code == 200
    assert anybody.get(f"/episodes/{begun}").status_code == 404
