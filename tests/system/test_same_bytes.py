"""The same trial, seed and actions give the same bytes: in two processes, and in process against over HTTP."""

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from wrongturn_client import Client
from wrongturn_client.local_service import LocalService
from wrongturn_networks import load_suite
from wrongturn_protocol import Action, PracticeRequest, Track

DRIVE = """
import json, sys
from wrongturn_networks import load_suite
from wrongturn_protocol import Track
from wrongturn_sim import Episode

found = {}
for trial_id, actions in json.load(sys.stdin).items():
    episode = Episode(load_suite("wrong-command@1").trial(trial_id), Track.PRIVILEGED)
    episode.reset()
    for action in actions:
        if episode.outcome is None:
            episode.step(*action)
    outcome = episode.outcome or episode.abort()
    found[trial_id] = [episode.trajectory.to_json().decode(), outcome.model_dump_json(), episode.actions_sha256]
json.dump(found, sys.stdout)
"""


def drives() -> dict[str, list[tuple[float, float, float]]]:
    """Ten trials of all types and both faults, two of them twins, each with actions of its own."""
    suite = load_suite("wrong-command@1")
    chosen = [*suite.trials[::8], suite.trials[4].twin(), suite.trials[40].twin()]
    assert len(chosen) == 10
    actions = {}
    for trial in chosen:
        draw = random.Random(trial.seed)
        actions[trial.id] = [
            (draw.uniform(-0.3, 0.3), draw.uniform(0, 1), draw.choice((0.0, 0.0, 0.0, 0.3))) for _ in range(400)
        ]
    return actions


def in_another_process(actions: dict[str, list[tuple[float, float, float]]]) -> dict[str, list[str]]:
    done = subprocess.run(
        [sys.executable, "-c", DRIVE],
        input=json.dumps(actions),
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, list[str]] = json.loads(done.stdout)
    return found


@pytest.mark.system
def test_ten_trials_have_the_same_bytes_in_two_processes_and_over_http(tmp_path: Path) -> None:
    actions = drives()
    first = in_another_process(actions)
    backwards = in_another_process(dict(reversed(actions.items())))
    assert first == backwards
    verdicts = {json.loads(outcome)["verdict"] for _, outcome, _ in first.values()}
    assert len(verdicts) >= 2, "trials that all end alike would show little"

    with (
        LocalService(database=f"sqlite+aiosqlite:///{tmp_path / 'wrongturn.db'}") as service,
        Client(service.url) as anybody,
    ):
        token = anybody.register("same bytes", Track.PRIVILEGED).token
        with Client(service.url, token) as client:
            for trial_id, wanted in actions.items():
                request = PracticeRequest(suite="wrong-command@1", trial=trial_id, track=Track.PRIVILEGED)
                episode = client.practise(request)
                for seq, (steer, throttle, brake) in enumerate(wanted, 1):
                    reply = client.step(episode.id, seq, Action(steer=steer, throttle=throttle, brake=brake))
                    if reply.terminated or reply.truncated:
                        break
                else:
                    client.abort_episode(episode.id)
                trajectory, outcome, actions_sha256 = first[trial_id]
                assert client.trajectory(episode.id) == trajectory.encode()
                detail = client.episode(episode.id)
                assert detail.outcome is not None
                assert detail.outcome.model_dump_json() == outcome
                assert detail.actions_sha256 == actions_sha256
