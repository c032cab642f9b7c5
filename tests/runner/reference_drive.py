"""Drives an evaluation's trials in this process, with onnxruntime and without any part of the runner."""

from functools import cache
from typing import Any

import numpy as np
import onnxruntime

from wrongturn_networks import load_suite
from wrongturn_protocol import Track
from wrongturn_sim import Episode, Simulator


@cache
def _simulator() -> Simulator:
    return Simulator()


def reference(model: bytes, suite: str, secret: str) -> dict[str, tuple[str, str]]:
    """Return verdict and trajectory's SHA-256 of each trial that a secret draws, by trial."""
    session = onnxruntime.InferenceSession(model)
    inputs = [put.name for put in session.get_inputs()]
    outputs = [put.name for put in session.get_outputs()]
    found = {}
    for trial in load_suite(suite).draw(secret).episodes:
        episode = Episode(trial, Track.PRIVILEGED, simulator=_simulator())
        observation: dict[str, Any] = dict(episode.reset())
        state = np.zeros((1, 1), np.float32)
        while episode.outcome is None:
            feed = {name: state if name == "state_in" else observation[name][None] for name in inputs}
            given = dict(zip(outputs, session.run(outputs, feed), strict=True))
            state = given.get("state_out", state)
            accelerate = given["accelerate"].item()
            step = episode.step(given["steer"].item(), max(accelerate, 0.0), max(-accelerate, 0.0))
            observation = dict(step.observation)
        found[trial.id] = (episode.outcome.verdict.value, episode.trajectory.sha256)
    return found
