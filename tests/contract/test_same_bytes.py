"""The same trial and actions give the same bytes: in process, in another process, over the wire.

Over HTTP in both encodings, and by the vectorised environment, whose steps go over the socket.
"""

import hashlib
import math
import subprocess
import sys
from typing import Any

import msgpack
import numpy as np
import pytest
from service_harness import RunningService, expect

from wrongturn_client import RemoteVectorEnv
from wrongturn_networks import load_suite
from wrongturn_protocol import Action, Outcome, Track, Trial
from wrongturn_protocol.observations import Observation, decode
from wrongturn_sim import Episode

SUITE = "wrong-command@2"
TRIALS = load_suite(SUITE).episodes[3::11][:10]
assert len(TRIALS) == 10
PICTURED = TRIALS[2:5]
"""Driven with a camera too."""


def action_of(trial: Trial, step: int) -> Action:
    """A swerving drive, another for each trial."""
    phase = step / 7 + trial.seed
    return Action(steer=0.35 * math.sin(phase), throttle=0.5 + 0.4 * math.cos(phase / 3), brake=0.0)


def in_process(trial: Trial, track: Track = Track.PRIVILEGED) -> tuple[list[Observation], bytes, str]:
    episode = Episode(trial, track)
    seen = [_copy(episode.reset())]
    while episode.outcome is None:
        action = action_of(trial, episode.steps)
        seen.append(_copy(episode.step(action.steer, action.throttle, action.brake).observation))
    return seen, episode.trajectory.to_json(), episode.outcome.model_dump_json()


def _copy(observation: Observation) -> Observation:
    return {name: array.copy() for name, array in observation.items()}


def digest_of(trial: Trial, track: Track = Track.PRIVILEGED) -> str:
    seen, trajectory, outcome = in_process(trial, track)
    parts = [observation[name].tobytes() for observation in seen for name in sorted(observation)]
    return hashlib.sha256(b"".join([*parts, trajectory, outcome.encode()])).hexdigest()


@pytest.mark.parametrize(("trials", "track"), [("TRIALS", Track.PRIVILEGED), ("PICTURED", Track.SEGMENTATION)])
def test_in_two_processes(trials: str, track: Track) -> None:
    here = [digest_of(trial, track) for trial in globals()[trials]]
    # In the other order, so that what was driven before would show.
    command = (
        "import sys, runpy; names = runpy.run_path(sys.argv[1]); "
        "trials, track = names[sys.argv[2]], names['Track'](sys.argv[3]); "
        "print('\\n'.join(reversed([names['digest_of'](trial, track) for trial in reversed(trials)])))"
    )
    path = [str(folder) for folder in sys.path if folder]
    there = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {path!r}; {command}", __file__, trials, track.value],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert there.stdout.split() == here
    assert len(set(here)) == len(here)


DRIVES = [*((trial, Track.PRIVILEGED) for trial in TRIALS), *((trial, Track.SEGMENTATION) for trial in PICTURED)]


@pytest.mark.parametrize(("trial", "track"), DRIVES, ids=[f"{track}-{trial.id}" for trial, track in DRIVES])
def test_in_process_and_over_http(service: RunningService, trial: Trial, track: Track) -> None:
    observations, trajectory, outcome = in_process(trial, track)
    media = ("application/json", "application/msgpack")[TRIALS.index(trial) % 2]
    with service.agent(track.value) as agent:

        def call(path: str, body: dict[str, Any], status: int) -> dict[str, Any]:
            headers = {"Content-Type": "application/msgpack", "Accept": media}
            response = agent.http.post(path, content=msgpack.packb(body), headers=headers)
            assert response.status_code == status, response.text
            return response.json() if media.endswith("json") else msgpack.unpackb(response.content)

        reply = call("/v1/episodes", {"suite": SUITE, "trial": trial.id, "track": track.value}, 201)
        episode = reply["id"]
        for step, expected in enumerate(observations):
            if step:
                action = action_of(trial, step - 1).model_dump()
                reply = call(f"/v1/episodes/{episode}/step", {"seq": step, "action": action}, 200)
            got = decode(reply["observation"], track)
            for name, array in expected.items():
                assert np.array_equal(got[name], array), (step, name)
        assert reply["terminated"] or reply["truncated"]
        assert agent.trajectory(episode) == trajectory
        shown = expect(agent.http.get(f"/v1/episodes/{episode}"), 200)
        assert reply["verdict"] == shown["outcome"]["verdict"]
        assert Outcome.model_validate_json(outcome) == Outcome.model_validate(shown["outcome"], strict=False)


@pytest.mark.parametrize(("trials", "track"), [(TRIALS[:2], Track.PRIVILEGED), (PICTURED[:2], Track.SEGMENTATION)])
def test_in_process_and_in_the_vectorised_environment(
    service: RunningService, trials: list[Trial], track: Track
) -> None:
    alone = [in_process(trial, track) for trial in trials]
    with service.agent(track.value) as agent:
        envs = RemoteVectorEnv(2, service.url, agent.token, track=track, suite=SUITE, autoreset_mode="SameStep")
        batch, _ = envs.reset(options={"trial": [trial.id for trial in trials]})
        left = {0, 1}
        for step in range(1, 1 + max(len(observations) for observations, _, _ in alone)):
            for i in left:
                for name, array in alone[i][0][step - 1].items():
                    assert batch[name][i].tobytes() == array.tobytes(), (trials[i].id, step - 1, name)
            actions = [list(action_of(trial, step - 1).model_dump().values()) for trial in trials]
            batch, _, terminated, truncated, infos = envs.step(np.array(actions))
            for i in sorted(left & set(np.flatnonzero(terminated | truncated).tolist())):
                left.remove(i)
                assert step == len(alone[i][0]) - 1
                for name, array in alone[i][0][step].items():
                    assert infos["final_obs"][i][name].tobytes() == array.tobytes(), (trials[i].id, step, name)
                assert infos["final_info"]["verdict"][i] == Outcome.model_validate_json(alone[i][2]).verdict
            if not left:
                break
        assert not left
        envs.close()
