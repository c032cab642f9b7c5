"""MaRLn with few channels, for trainings of seconds."""

from functools import partial

import pytest

from wrongturn_agents.models.marln import Marln
from wrongturn_agents.training.marln import network

OPTIONS = (
    *("num_envs=4", "batch_size=8", "replay_size=400", "learn_after=32", "traffic=0", "hidden=16"),
    *("pretraining_frames=16", "pretraining_batch=8", "pretraining_passes=1"),
    *("journeys=1", "brief_journeys=1", "patience=1"),
)


@pytest.fixture
def small_marln(monkeypatch):
    """Build the agent with few channels and one block in each stage."""
    small = partial(Marln, widths=(8, 8, 16, 16), depths=(1, 1, 1, 1))
    monkeypatch.setattr(network, "Marln", small)
