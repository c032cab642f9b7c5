"""Reset and step by the interface's word: sequence numbers, repeats, encodings, what is shown and when."""

import hashlib
import struct
from concurrent.futures import ThreadPoolExecutor

import msgpack
import numpy as np
from service_harness import COAST, GAS, Agent, expect, problem

from wrongturn_protocol import Track
from wrongturn_protocol.observations import FIELDS, decode


def test_a_practice_episode_from_reset_to_verdict(agent: Agent) -> None:
    reset = agent.practise(fault="infeasible", approach="J3-S")
    assert set(reset) == {"id", "seq", "observation", "lease_expires_in_s", "town", "trial"}
    assert reset["seq"] == 0
    assert reset["town"] == "Town01"
    assert reset["trial"] == "Town01.J3-S.infeasible.s3"
    assert set(reset["observation"]) == {field.name for field in FIELDS[Track.PRIVILEGED]}, "the agent's own track"
    steps, last = agent.drive(reset["id"])
    assert set(last) == {"seq", "observation", "terminated", "truncated", "reward", "verdict"}
    shown = expect(agent.http.get(f"/v1/episodes/{reset['id']}"), 200)
    assert shown["state"] == "finished"
    assert shown["outcome"]["verdict"] == last["verdict"]
    assert shown["seq"] == steps
    assert shown["last_reply"] is None
    trajectory = agent.trajectory(reset["id"])
    assert hashlib.sha256(trajectory).hexdigest() == shown["trajectory_sha256"]
    actions = struct.pack("<3f", *GAS.values()) * steps
    assert hashlib.sha256(actions).hexdigest() == shown["actions_sha256"]
    # The last reply may have been lost on the way: the same step again gives it again, from the database.
    assert expect(agent.step(reset["id"], steps), 200) == last
    problem(agent.step(reset["id"], steps, COAST), 409, "action-mismatch")
    for seq in (1, steps + 1):
        problem(agent.step(reset["id"], seq), 409, "episode-finished")
    problem(agent.http.delete(f"/v1/episodes/{reset['id']}"), 409, "episode-finished")


def test_a_step_again_gives_the_stored_reply(agent: Agent) -> None:
    episode = agent.practise(track="privileged")["id"]
    first = expect(agent.step(episode, 1), 200)
    assert expect(agent.step(episode, 1), 200) == first
    problem(agent.step(episode, 1, COAST), 409, "action-mismatch")
    second = expect(agent.step(episode, 2), 200)
    assert second["seq"] == 2
    assert second["observation"]["pose"] != first["observation"]["pose"]
    problem(agent.step(episode, 1), 409, "sequence-gap")
    problem(agent.step(episode, 4), 409, "sequence-gap")
    assert expect(agent.http.get(f"/v1/episodes/{episode}"), 200)["last_reply"] == second
    # What differs by less than a float32 is the same action.
    almost = {**GAS, "throttle": GAS["throttle"] + 1e-12}
    assert expect(agent.step(episode, 2, almost), 200) == second


def test_the_same_step_at_the_same_time_is_one_step(agent: Agent) -> None:
    episode = agent.practise()["id"]
    with ThreadPoolExecutor(8) as threads:
        replies = list(threads.map(lambda _: expect(agent.step(episode, 1), 200), range(8)))
    assert all(reply == replies[0] for reply in replies)
    with ThreadPoolExecutor(8) as threads:
        codes = [
            response.status_code
            for response in threads.map(lambda number: agent.step(episode, 2, {**GAS, "steer": number / 10}), range(8))
        ]
    assert sorted(codes) == [200] + [409] * 7
    assert expect(agent.http.get(f"/v1/episodes/{episode}"), 200)["seq"] == 2


def test_msgpack_says_the_same_as_json(agent: Agent) -> None:
    binary = {"Accept": "application/msgpack", "Content-Type": "application/msgpack"}
    body = {"town": "Town01", "approach": "J3-S", "seed": 3, "track": "privileged", "fault": "omission"}
    response = agent.http.post("/v1/episodes", content=msgpack.packb(body), headers=binary)
    assert response.status_code == 201
    assert response.headers["content-type"] == "application/msgpack"
    reset = msgpack.unpackb(response.content)
    assert isinstance(reset["observation"]["lane"]["data"], bytes)
    url = f"/v1/episodes/{reset['id']}"
    step = msgpack.packb({"seq": 1, "action": GAS})
    packed = agent.http.post(f"{url}/step", content=step, headers=binary)
    # The repeat asks for the other encoding.
    plain = expect(agent.step(reset["id"], 1), 200)
    again = agent.http.post(f"{url}/step", content=step, headers=binary)
    assert again.content == packed.content
    message = msgpack.unpackb(packed.content)
    assert {key: value for key, value in message.items() if key != "observation"} == {
        key: value for key, value in plain.items() if key != "observation"
    }
    one, other = (decode(reply["observation"], Track.PRIVILEGED) for reply in (message, plain))
    assert all(np.array_equal(one[name], other[name]) for name in one)
    shown = msgpack.unpackb(agent.http.get(url, headers={"Accept": "application/msgpack"}).content)
    assert shown["last_reply"] == message
    agent.http.delete(url)


def test_an_episode_given_up(agent: Agent) -> None:
    episode = agent.practise(fault="omission")["id"]
    expect(agent.step(episode, 1), 200)
    problem(agent.http.get(f"/v1/episodes/{episode}/trajectory"), 409, "episode-not-shown")
    for _ in range(2):
        response = agent.http.delete(f"/v1/episodes/{episode}")
        assert (response.status_code, response.content) == (204, b"")
    shown = expect(agent.http.get(f"/v1/episodes/{episode}"), 200)
    assert shown["outcome"]["verdict"] == "aborted"
    assert len(agent.trajectory(episode)) > 100
    problem(agent.step(episode, 2), 409, "episode-finished")


def test_practice_by_suite_and_trial(agent: Agent) -> None:
    trials = expect(agent.http.get("/v1/suites/smoke@3/trials"), 200)["trials"]
    assert len(trials) == 6
    for trial in (trials[0]["id"], trials[0]["twin"]):
        reset = agent.practise(suite="smoke@3", trial=trial, track="privileged")
        assert reset["trial"] == trial
        assert set(reset["observation"]) > {"pose", "lane", "exits", "road_users"}
