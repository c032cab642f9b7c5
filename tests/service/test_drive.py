"""The socket means what the REST calls mean."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from drive_socket import DriveSocket
from service_harness import GAS, Agent, RunningService, expect, problem

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import decode

ACTION = (0.0, 0.8, 0.0)
PRACTICE = {"town": "Town01", "approach": "J3-S", "seed": 3}


@pytest.fixture
def drive(service: RunningService, agent: Agent) -> Iterator[DriveSocket]:
    with DriveSocket(service, agent.token) as drive:
        yield drive


@pytest.mark.parametrize("track", Track)
def test_observations_are_those_of_http(service: RunningService, track: Track) -> None:
    with service.agent(track.value) as agent, DriveSocket(service, agent.token) as drive:
        told = agent.practise()
        status, fields, block = drive.one("practise", {**PRACTICE, "track": track.value}, None)
        assert status == 201
        assert fields.keys() == told.keys() - {"observation"}
        _same(told["observation"], block, track)
        over_http = told["id"]
        for seq in range(1, 4):
            told = expect(agent.step(over_http, seq), 200)
            status, stepped, block = drive.one("step", fields["id"], seq, *ACTION)
            _same(told.pop("observation"), block, track)
            assert (status, stepped) == (200, told)
        assert drive.one("abort", fields["id"]) == [204, {}]


def test_practice_is_in_the_agents_own_track(agent: Agent, drive: DriveSocket) -> None:
    wanted = {**PRACTICE, "track": "camera"}
    over_http = problem(agent.http.post("/v1/episodes", json=wanted), 422, "track-not-available", "track")
    status, over_socket, *_ = drive.one("practise", wanted, None)
    assert (status, over_socket["detail"]) == (422, over_http["detail"])
    assert "camera" in over_http["detail"]
    assert "privileged" in over_http["detail"]


def _same(message: dict[str, object], block: bytes, track: Track) -> None:
    over_http, over_socket = decode(message, track), wire.arrays(block)
    assert over_http.keys() == over_socket.keys()
    for name, array in over_http.items():
        np.testing.assert_array_equal(over_socket[name], array)


def test_an_episode_may_be_driven_over_both_in_turn(agent: Agent, drive: DriveSocket) -> None:
    episode = agent.practise()["id"]
    assert drive.one("step", episode, 1, *ACTION)[0] == 200
    expect(agent.step(episode, 2), 200)
    again = drive.one("step", episode, 2, *ACTION)
    assert again[:2] == [200, {**again[1], "seq": 2}]
    told = expect(agent.step(episode, 2), 200)
    _same(told["observation"], again[2], Track.PRIVILEGED)


def test_each_call_of_a_batch_has_its_own_result(agent: Agent, other: Agent, drive: DriveSocket) -> None:
    mine, mine_too, others = agent.practise()["id"], agent.practise()["id"], other.practise()["id"]
    results = drive.call(
        ["step", mine, 1, *ACTION],
        ["step", mine_too, 2, *ACTION],
        ["step", others, 1, *ACTION],
        ["step", "ep_none", 1, *ACTION],
        ["step", mine, 2, 2.0, 0.0, 0.0],
        ["step", mine, 2, float("nan"), True, 0.0],
        ["step", 7, 1, *ACTION],
        ["step", mine],
        ["fly", mine],
        17,
        ["step", mine, 2, *ACTION],
        ["look", others],
        ["abort", others],
        ["look", "ep_none"],
    )
    kinds = [result[1].get("type", "/problems/").rsplit("/", 1)[-1] for result in results]
    last = ["", "forbidden", "forbidden", "unknown-episode"]
    assert kinds == ["", "sequence-gap", "forbidden", "unknown-episode", *["validation"] * 6, *last]
    assert [result[0] for result in results] == [200, 409, 403, 404, *[422] * 6, 200, 403, 403, 404]
    assert [error["path"] for error in results[4][1]["errors"]] == ["action.steer"]
    assert [error["path"] for error in results[5][1]["errors"]] == ["action.steer", "action.throttle"]
    assert [result[1]["errors"][0]["path"] for result in results[6:10]] == ["episode", "call", "call", "call"]
    assert results[10][1]["seq"] == 2


def test_problems_are_those_of_http(agent: Agent, drive: DriveSocket) -> None:
    episode = agent.practise()["id"]
    drive.one("step", episode, 1, *ACTION)
    for seq, action, kind in ((1, 0.1, "action-mismatch"), (5, 0.1, "sequence-gap"), (0, 0.1, "validation")):
        response = agent.step(episode, seq, {**GAS, "brake": action})
        told = problem(response, response.status_code, kind)
        assert drive.one("step", episode, seq, 0.0, 0.8, action) == [response.status_code, told]


def test_messages_are_answered_side_by_side(agent: Agent, drive: DriveSocket) -> None:
    episode = agent.practise()["id"]
    slow = drive.send(*(["practise", {**PRACTICE, "seed": seed}, None] for seed in range(3)))
    quick = drive.send(["step", episode, 1, *ACTION])
    answered = dict(drive.receive() for _ in range(2))
    assert answered.keys() == {slow, quick}
    assert answered[quick][0][0] == 200
    drive.call(*(["abort", result[1]["id"]] for result in answered[slow] if result[0] == 201))


def test_steps_of_one_episode_may_be_sent_ahead(agent: Agent, drive: DriveSocket) -> None:
    episode = agent.practise()["id"]
    results = drive.call(*(["step", episode, seq, *ACTION] for seq in range(1, 9)))
    assert [result[1]["seq"] for result in results] == list(range(1, 9))


def test_a_repeated_key_gives_the_same_episode(agent: Agent, drive: DriveSocket) -> None:
    evaluation = agent.evaluate()["id"]
    first = drive.one("next", evaluation, "a key")
    assert drive.one("next", evaluation, "a key") == first
    begun = drive.one("practise", PRACTICE, "another")
    assert drive.one("practise", PRACTICE, "another") == begun
    assert drive.one("practise", {**PRACTICE, "seed": 4}, "another")[1]["type"] == "/problems/idempotency-key-reused"
    assert drive.one("next", evaluation, "")[0] == 422
    drive.call(["abort", first[1]["id"]], ["abort", begun[1]["id"]])


def test_a_look_shows_the_last_reply(agent: Agent, drive: DriveSocket) -> None:
    episode = agent.practise()["id"]
    stepped = drive.one("step", episode, 1, *ACTION)
    status, detail, block = drive.one("look", episode)
    assert (status, detail["state"], detail["seq"]) == (200, "open", 1)
    assert [200, detail["last_reply"], block] == stepped
    drive.one("abort", episode)
    status, detail = drive.one("look", episode)
    assert (status, detail["state"], detail["outcome"]["verdict"]) == (200, "finished", "aborted")


def test_what_was_begun_is_finished_when_the_client_leaves(service: RunningService, agent: Agent) -> None:
    episode = agent.practise()["id"]
    with DriveSocket(service, agent.token) as drive:
        drive.send(["step", episode, 1, *ACTION])
        drive.send(["step", episode, 2, *ACTION])
    with DriveSocket(service, agent.token) as drive:
        assert drive.one("step", episode, 2, *ACTION)[1].get("seq") == 2


def test_the_pages_example_is_answered_as_the_page_has_it(drive: DriveSocket) -> None:
    page = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")
    sent, told = (bytes.fromhex(re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL)[0]) for kind in ("call", "reply"))
    drive.socket.send(sent)
    answered = drive.socket.recv(30)
    refused = wire.pack_result(*wire.unpack_results(told)[1][1])
    assert isinstance(answered, bytes)
    assert told.endswith(refused)
    assert answered.endswith(refused)
