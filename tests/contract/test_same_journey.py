"""A journey and its actions give the same bytes in process and over HTTP, and after its simulator has died."""

import math
import os
import signal
from pathlib import Path

import msgpack
import numpy as np
import pytest
from service_harness import RunningService, expect

from wrongturn_networks import load_suite
from wrongturn_protocol import Action, Outcome, Track, Trial
from wrongturn_protocol.observations import Observation, decode
from wrongturn_sim import Episode

SUITE = "navigation@1"
STRAIGHT_ON = next(trial for trial in load_suite(SUITE).trials if trial.id.startswith("Town02.straight"))
AMONG_OTHERS = next(trial for trial in load_suite(SUITE).trials if trial.id.startswith("Town02.navigation_dynamic"))
LONGEST = max(load_suite(SUITE).trials, key=lambda trial: trial.journey.time_limit if trial.journey else 0.0)


def creep(step: int) -> Action:
    """Slowly on, and off the lane before long: what is off the road is counted, and the drive goes on."""
    return Action(steer=0.02 * math.sin(step / 9), throttle=0.3 if step % 50 < 25 else 0.0, brake=0.0)


def in_process(trial: Trial, track: Track, most: int) -> tuple[list[Observation], Episode]:
    episode = Episode(trial, track)
    seen = [_copy(episode.reset())]
    while episode.outcome is None and len(seen) <= most:
        action = creep(episode.steps)
        seen.append(_copy(episode.step(action.steer, action.throttle, action.brake).observation))
    return seen, episode


def _copy(observation: Observation) -> Observation:
    return {name: array.copy() for name, array in observation.items()}


@pytest.mark.parametrize(
    ("trial", "track", "most"),
    [
        (STRAIGHT_ON, Track.PRIVILEGED, 5000),
        (AMONG_OTHERS, Track.PRIVILEGED, 150),
        (STRAIGHT_ON, Track.SEGMENTATION, 50),
    ],
    ids=["to-its-end", "among-others", "pictured"],
)
def test_in_process_and_over_http(service: RunningService, trial: Trial, track: Track, most: int) -> None:
    observations, episode = in_process(trial, track, most)
    headers = {"Content-Type": "application/msgpack", "Accept": "application/msgpack"}
    with service.agent(track.value) as agent:
        body = msgpack.packb({"suite": SUITE, "trial": trial.id, "track": track.value})
        response = agent.http.post("/v1/episodes", content=body, headers=headers)
        assert response.status_code == 201, response.text
        reply = msgpack.unpackb(response.content)
        name = reply["id"]
        for step, expected in enumerate(observations):
            if step:
                body = msgpack.packb({"seq": step, "action": creep(step - 1).model_dump()})
                response = agent.http.post(f"/v1/episodes/{name}/step", content=body, headers=headers)
                assert response.status_code == 200, response.text
                reply = msgpack.unpackb(response.content)
            got = decode(reply["observation"], track)
            assert all(np.array_equal(got[key], array) for key, array in expected.items()), step
        if episode.outcome is None:
            assert not reply["terminated"]
            episode.abort()
            assert agent.http.delete(f"/v1/episodes/{name}").status_code == 204
        assert agent.trajectory(name) == episode.trajectory.to_json()
        shown = expect(agent.http.get(f"/v1/episodes/{name}"), 200)
        assert episode.outcome is not None
        told = Outcome.model_validate_json(episode.outcome.model_dump_json())
        assert Outcome.model_validate(shown["outcome"], strict=False) == told
        assert told.journey is not None


@pytest.mark.parametrize("steps", [150, pytest.param(10_000, marks=pytest.mark.soak)])
def test_a_long_journey_outlives_its_simulator(tmp_path: Path, steps: int) -> None:
    """Standing still: to the end of its time, or for so many steps."""
    assert LONGEST.journey is not None
    last = min(steps, round(10 * LONGEST.journey.time_limit))
    episode = Episode(LONGEST, Track.PRIVILEGED)
    episode.reset()
    service = RunningService(tmp_path / "wrongturn.db", simulators=1, lease_release_s=300)
    try:
        with service.agent() as agent:
            name = agent.practise(suite=SUITE, trial=LONGEST.id, track="privileged")["id"]
            brake = {"steer": 0.0, "throttle": 0.0, "brake": 1.0}
            for seq in range(1, last + 1):
                if seq == last - 5:
                    (pid,) = service.simulators()
                    os.kill(pid, signal.SIGKILL)
                reply = expect(agent.step(name, seq, brake), 200)
                episode.step(*brake.values())
            assert "wrongturn_replays_total 1.0" in agent.http.get("/metrics").text
            if last < steps:
                assert (reply["truncated"], reply["verdict"]) == (True, "timeout")
            else:
                episode.abort()
                assert agent.http.delete(f"/v1/episodes/{name}").status_code == 204
            assert agent.trajectory(name) == episode.trajectory.to_json()
        assert service.stop() == 0, service.stderr
    finally:
        if not service.process.stdout.closed:  # type: ignore[union-attr]
            service.kill()
