"""The same trial and actions give the same bytes: in process, in another process, and over HTTP in both encodings.

``tests/environments`` compares the environments over the wire, whose steps go over the socket, with those in process.
"""

import hashlib
import math
import subprocess
import sys
from typing import Any, NamedTuple

import msgpack
import numpy as np
import pytest
from service_harness import RunningService, expect

from wrongturn_networks import load_suite
from wrongturn_protocol import Action, Outcome, Track, Trial
from wrongturn_protocol.observations import Observation, decode
from wrongturn_sim import Episode

SUITE, JOURNEYS = "wrong-command@3", "navigation@1"
TRIALS = load_suite(SUITE).episodes[3::19][:6]
assert len(TRIALS) == 6
PICTURED = TRIALS[2:4]
"""Driven with a camera too."""
STRAIGHT_ON = next(trial for trial in load_suite(JOURNEYS).trials if trial.id.startswith("Town02.straight"))
AMONG_OTHERS = next(trial for trial in load_suite(JOURNEYS).trials if trial.id.startswith("Town02.navigation_dynamic"))


class Drive(NamedTuple):
    """One of the drives to compare, and at most so many steps of it."""

    suite: str
    trial: Trial
    track: Track
    most: int = 5000


AT_JUNCTIONS = [
    *(Drive(SUITE, trial, Track.PRIVILEGED) for trial in TRIALS),
    *(Drive(SUITE, trial, Track.SEGMENTATION) for trial in PICTURED),
]
ELSEWHERE = AT_JUNCTIONS[::3]
"""Driven in another process too."""
DRIVES = [
    *AT_JUNCTIONS,
    Drive(JOURNEYS, STRAIGHT_ON, Track.PRIVILEGED),
    Drive(JOURNEYS, AMONG_OTHERS, Track.PRIVILEGED, 150),
    Drive(JOURNEYS, STRAIGHT_ON, Track.SEGMENTATION, 50),
]


def action_of(trial: Trial, step: int) -> Action:
    """A swerving drive, another for each trial; on a journey slowly on, and off the lane before long."""
    if trial.journey is not None:
        return Action(steer=0.02 * math.sin(step / 9), throttle=0.3 if step % 50 < 25 else 0.0, brake=0.0)
    phase = step / 7 + trial.seed
    return Action(steer=0.35 * math.sin(phase), throttle=0.5 + 0.4 * math.cos(phase / 3), brake=0.0)


def in_process(trial: Trial, track: Track = Track.PRIVILEGED, most: int = 5000) -> tuple[list[Observation], Episode]:
    episode = Episode(trial, track)
    seen = [_copy(episode.reset())]
    while episode.outcome is None and len(seen) <= most:
        action = action_of(trial, episode.steps)
        seen.append(_copy(episode.step(action.steer, action.throttle, action.brake).observation))
    return seen, episode


def _copy(observation: Observation) -> Observation:
    return {name: array.copy() for name, array in observation.items()}


def digest_of(trial: Trial, track: Track = Track.PRIVILEGED) -> str:
    seen, episode = in_process(trial, track)
    assert episode.outcome is not None
    parts = [observation[name].tobytes() for observation in seen for name in sorted(observation)]
    told = [episode.trajectory.to_json(), episode.outcome.model_dump_json().encode()]
    return hashlib.sha256(b"".join([*parts, *told])).hexdigest()


def digests(drives: list[Drive]) -> list[str]:
    return [digest_of(drive.trial, drive.track) for drive in drives]


def test_in_two_processes() -> None:
    here = digests(ELSEWHERE)
    # In the other order, so that what was driven before would show.
    command = (
        f"import sys, runpy; sys.path[:0] = {[folder for folder in sys.path if folder]!r}; "
        "names = runpy.run_path(sys.argv[1]); print('\\n'.join(names['digests'](names['ELSEWHERE'][::-1])))"
    )
    there = subprocess.run(
        [sys.executable, "-c", command, __file__], capture_output=True, text=True, check=True, timeout=120
    )
    assert there.stdout.split()[::-1] == here
    assert len(set(here)) == len(here)


@pytest.mark.parametrize("drive", DRIVES, ids=[f"{drive.track}-{drive.trial.id}" for drive in DRIVES])
def test_in_process_and_over_http(service: RunningService, drive: Drive) -> None:
    suite, trial, track, most = drive
    observations, episode = in_process(trial, track, most)
    media = ("application/json", "application/msgpack")[DRIVES.index(drive) % 2]
    with service.agent(track.value) as agent:

        def call(path: str, body: dict[str, Any], status: int) -> dict[str, Any]:
            headers = {"Content-Type": "application/msgpack", "Accept": media}
            response = agent.http.post(path, content=msgpack.packb(body), headers=headers)
            assert response.status_code == status, response.text
            return response.json() if media.endswith("json") else msgpack.unpackb(response.content)

        reply = call("/v1/episodes", {"suite": suite, "trial": trial.id, "track": track.value}, 201)
        name = reply["id"]
        for step, expected in enumerate(observations):
            if step:
                action = action_of(trial, step - 1).model_dump()
                reply = call(f"/v1/episodes/{name}/step", {"seq": step, "action": action}, 200)
            got = decode(reply["observation"], track)
            for field, array in expected.items():
                assert np.array_equal(got[field], array), (step, field)
        if episode.outcome is None:
            assert not reply["terminated"]
            episode.abort()
            assert agent.http.delete(f"/v1/episodes/{name}").status_code == 204
        else:
            assert reply["verdict"] == episode.outcome.verdict
        assert agent.trajectory(name) == episode.trajectory.to_json()
        shown = expect(agent.http.get(f"/v1/episodes/{name}"), 200)
        assert episode.outcome is not None
        told = Outcome.model_validate_json(episode.outcome.model_dump_json())
        assert Outcome.model_validate(shown["outcome"], strict=False) == told
        assert (told.journey is None) == (trial.journey is None)
