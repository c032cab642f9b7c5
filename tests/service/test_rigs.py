"""Agents with a rig, over HTTP, over the socket and from a file."""

from typing import Any

import gymnasium
import httpx
import numpy as np
import pytest
from service_harness import RunningService, problem

from wrongturn_client import Client, ConflictError, PolicyError
from wrongturn_networks import load_suite
from wrongturn_protocol import OptionError, PracticeRequest
from wrongturn_protocol.answers import driver_of
from wrongturn_protocol.observations import text
from wrongturn_protocol.rigs import rig_of
from wrongturn_sim import Episode

RIG = rig_of(
    {
        "cameras": [
            {"name": "front", "width": 320, "height": 96, "fov": 100, "jpeg": 70},
            {"name": "left", "width": 64, "height": 48, "yaw": 55, "history": 2},
        ],
        "navigation": ["command", "distance", "target_points"],
        "rate": 20,
        "action": {"kind": "waypoints", "times": [0.5, 1.0]},
    }
)
assert RIG is not None
TRIAL = load_suite("smoke@3").open_draw.trials[0]


class Straight:
    """Drives straight on, by waypoints."""

    rig = RIG

    def __init__(self) -> None:
        self.seen: list[dict[str, Any]] = []

    def reset(self, space: Any) -> None:
        assert set(space) == {"speed", "steering", "command", "distance", "target_points", "front", "left"}

    def act(self, observation: dict[str, Any]) -> list[list[float]]:
        self.seen.append(observation)
        return [[3.0, 0.0], [6.0, 0.0]]


@pytest.mark.parametrize("way", ["socket", "json", "msgpack"])
def test_a_rigs_observations_are_those_in_process(service: RunningService, way: str) -> None:
    with Client(service.url) as stranger:
        token = stranger.register(f"rig by {way}", "camera", rig=RIG).token
    episode = Episode(TRIAL, RIG)
    wanted, control = episode.reset(), driver_of(RIG)
    with Client(service.url, token) as client:
        calls = client.drive() if way == "socket" else client
        if way == "json":
            client._media_type = "application/json"
        begun = calls.practise(PracticeRequest(suite="smoke@3", trial=TRIAL.id))
        told = begun.observation
        for seq in range(1, 12):
            assert list(told) == list(wanted)
            for name, array in wanted.items():
                assert (told[name].dtype, told[name].tobytes()) == (array.dtype, array.tobytes()), name
            action = control([[4.0, 0.5], [8.0, 1.0]], told)
            wanted = episode.step(action.steer, action.throttle, action.brake).observation
            told = calls.step(begun.id, seq, action).observation
        detail = client.episode(begun.id)
        assert detail.last_reply is not None
        np.testing.assert_array_equal(detail.last_reply["observation"]["left"], wanted["left"])
        calls.abort_episode(begun.id)


def test_an_evaluation_is_driven_by_waypoints_and_shows_its_rig(service: RunningService) -> None:
    with Client(service.url) as stranger:
        registered = stranger.register("straight on", "camera", rig=RIG)
        assert stranger.agent(registered.id).rig == RIG
    policy = Straight()
    with Client(service.url, registered.token) as client:
        evaluation = client.evaluate(policy, "smoke@3")
        assert evaluation.metrics is not None
        assert len(policy.seen) > 100
        page = httpx.get(f"{service.url}/agents/{registered.id}").text
        assert "front 320 x 96, left 64 x 48 x 2, command, distance, target points; 20 decisions per second" in page
        Straight.rig = RIG.model_copy(update={"cameras": RIG.cameras[:1]})
        with pytest.raises(PolicyError, match=r"Straight\.rig: left is not in it, and the service shows"):
            client.evaluate(policy, "wrong-command@3")
        Straight.rig = None
        with pytest.raises(PolicyError, match=r"Straight\.rig: there is none, and the agent was registered with one"):
            client.evaluate(policy, "wrong-command@3")
        Straight.rig = RIG
    env = gymnasium.make("wrongturn_client:Wrongturn-v0", url=service.url, token=registered.token, track="camera")
    with pytest.raises(OptionError, match="token: its agent has a rig"):
        env.reset(seed=1)
    env.close()


def test_a_what_if_of_twenty_decisions_a_second_repeats_each_of_them(service: RunningService) -> None:
    with Client(service.url) as stranger:
        token = stranger.register("what if by rig", "camera", rig=RIG).token
    with Client(service.url, token) as client:
        begun = client.practise(PracticeRequest(suite="smoke@3", trial=TRIAL.id))
        seq, over = 0, False
        while not over:
            seq += 1
            reply = client.step(begun.id, seq, (0.0, 0.3, 0.001 * (seq % 7)))
            over = reply.terminated or reply.truncated
        fork = client.whatif(begun.id, 1.0)
        for at in range(1, 20):
            client.step(fork.id, at, (0.0, 0.3, 0.001 * (at % 7)))
        with pytest.raises(ConflictError):
            client.step(fork.id, 20, (0.5, 0.3, 0.0))
        client.step(fork.id, 20, (0.0, 0.3, 0.001 * (20 % 7)))
        client.step(fork.id, 21, (0.5, 0.3, 0.0))
        client.abort_episode(fork.id)


class Hears:
    """Stands, and keeps what it is told."""

    def __init__(self) -> None:
        self.told: set[str] = set()

    def reset(self, space: Any) -> None:
        assert set(space) == {"speed", "steering", "sentence", "rgb"}

    def act(self, observation: dict[str, Any]) -> tuple[float, float, float]:
        self.told.add(text(observation["sentence"]))
        return 0.0, 0.0, 1.0


def test_an_agent_of_the_track_words_is_told_sentences_and_listed(service: RunningService) -> None:
    policy = Hears()
    with Client(service.url) as stranger:
        token = stranger.register("hears", "words").token
        with Client(service.url, token) as client:
            client.evaluate(policy, "smoke@3")
        board = stranger.leaderboard("smoke@3")
    assert ("hears", "words") in {(entry.agent.name, entry.agent.track) for entry in board.entries}
    assert len(policy.told) > 3
    assert httpx.get(f"{service.url}/leaderboards/smoke@3?track=words").status_code == 200


@pytest.mark.parametrize(
    ("agent", "path", "message"),
    [
        ({"track": "camera", "rig": {"cameras": [{"width": 4096, "height": 8}]}}, "rig.cameras.0.width", "2048"),
        ({"track": "privileged", "rig": {}}, "body", "the privileged track has none"),
        ({"track": "camera", "rig": {"navigation": ["gps"]}}, "rig.navigation.0", "target_points"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(service: RunningService, agent: Any, path: str, message: str) -> None:
    with service.agent() as other:
        refused = other.http.post("/v1/agents", json={"name": "no rig", **agent}, headers={"Authorization": ""})
    assert message in str(problem(refused, 422, "validation", path))
