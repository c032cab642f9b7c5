"""What an agent sees of a running evaluation does not tell a trial from its twin, before their commands differ."""

import re
from pathlib import Path

import numpy as np
import pytest
from app_harness import application, step
from service_harness import expect

from wrongturn_networks import load_suite
from wrongturn_networks.draws import halves
from wrongturn_protocol import Track
from wrongturn_sim import WrongturnVectorEnv

SECRETS = 24
_DRAWN = {"id", "content-length", "date", "x-request-id"}
"""What differs between any two replies."""


def seen_of(secret: str, envs: WrongturnVectorEnv) -> tuple[np.ndarray, np.ndarray]:
    """What an agent sees at the resets of an evaluation, as numbers (120, n), and which ones are trials (120,)."""
    order = [trial for half in halves(load_suite("wrong-command@3").draw(secret), secret) for trial in half]
    # No picture is compared, so the town's scenery does not matter.
    first, _ = envs.reset(seed=1, options={"trial": [one.model_copy(update={"scenery": None}) for one in order]})
    flat = [np.asarray(first[name], float).reshape(120, -1) for name in ("speed", "pose", "stop_line", "exits_mask")]
    place = np.arange(120)[:, None]
    columns = np.hstack([*flat, first["command"], place % 60, place >= 60, np.abs(first["exits"]).mean(axis=(2, 3))])
    # What came just before, and where the other of the pair may have been: the first half tells nothing of the second.
    columns = np.hstack([columns, np.roll(columns, 1, axis=0), np.sin(columns), columns**2])
    return columns, np.array([not trial.is_twin for trial in order])


def test_a_classifier_of_all_that_is_seen_guesses() -> None:
    envs = WrongturnVectorEnv(120, "Town01", Track.PRIVILEGED, record=False)
    told = [seen_of(f"secret {k}", envs) for k in range(SECRETS)]
    seen, is_trial = (np.concatenate([one[part] for one in told]) for part in (0, 1))
    seen = (seen - seen.mean(axis=0)) / (seen.std(axis=0) + 1e-9)
    half = len(seen) // 2
    weights, bias = np.zeros(seen.shape[1]), 0.0
    for _ in range(300):
        error = 1.0 / (1.0 + np.exp(-seen[:half] @ weights - bias)) - is_trial[:half]
        weights -= 0.5 * (seen[:half].T @ error / half + 0.01 * weights)
        bias -= 0.5 * error.mean()
    right = ((seen[half:] @ weights + bias > 0) == is_trial[half:]).mean()
    # Of 1440 guesses, half are right, with a standard deviation of 0.013.
    assert right == pytest.approx(0.5, abs=0.05)


async def test_no_field_or_header_of_a_running_evaluation_differs(tmp_path: Path) -> None:
    async with application(tmp_path, track="camera") as http:
        begun = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)
        url = f"/v1/evaluations/{begun['id']}/episodes"
        replies = []
        for _ in range(12):
            reset = await http.post(url)
            episode = expect(reset, 201)["id"]
            listed = expect(await http.get(url, params={"state": "open"}), 200)["episodes"]
            shown = await http.get(f"/v1/episodes/{episode}")
            wrong = await step(http, episode, 7)
            for seq in range(1, 11):
                last = await step(http, episode, seq)
            over = await step(http, episode, 11)
            texts = [one.text.replace(episode, "ID") for one in (reset, shown, wrong, last, over)]
            # Times differ by the clock. Observations are the simulator's, which the classifier has read.
            texts = [re.sub(r'"(created|finished|observation)":("[^"]*"|\{[^{}]*\}|[\d.]+)', "", one) for one in texts]
            heads = [(one.status_code, sorted(set(one.headers) - _DRAWN)) for one in (reset, shown, wrong, last, over)]
            replies.append((texts, heads, sorted(listed[0]), len(listed)))
        assert all(one == replies[0] for one in replies)
