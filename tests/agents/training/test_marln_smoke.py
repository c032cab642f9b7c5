"""A training of MaRLn of seconds on the CPU, with a small network: it must drive better than chance.

CI leaves it out. What it runs, in ``test_marln_train.py``, trains for a few steps and does not judge the driving.
"""

import numpy as np
import pytest
import torch
from small_marln import small_marln  # noqa: F401 - a fixture
from test_smoke import mean_reward

from wrongturn_agents.training.checkpoint import load_checkpoint
from wrongturn_agents.training.marln.network import marln_of
from wrongturn_agents.training.train import train

CARS = 16
OPTIONS = (
    *(f"num_envs={CARS}", "batch_size=32", "replay_ratio=4", "replay_size=8000", "learn_after=256", "hidden=16"),
    *("quantiles=4", "target_quantiles=4", "target_every=20", "n_step=3", "noise=0.3"),
    *("learning_rate=1.5e-3", "projection_learning_rate=1", "augment=false"),
    *("pretraining_frames=256", "pretraining_batch=32", "pretraining_passes=1"),
    # So few steps suffice for a short horizon, and for what is learned first: not to leave the road.
    *("gamma=0.9", "reward_divisor=30", "failure_penalty=2", "standing_penalty=2", "standing_cost=0"),
    *("time_limit=8", "inside_junctions=0", "traffic=0", "journeys=1", "brief_journeys=1", "patience=1"),
)


@pytest.mark.soak
def test_a_short_training_beats_a_random_policy(tmp_path, small_marln):  # noqa: F811
    random = np.random.default_rng(1)
    by_chance = mean_reward("marln", lambda _: random.uniform(-1.0, 1.0, (CARS, 2)))
    train("marln", directory=tmp_path / "run", seed=1, steps=4096, device="cpu", threads=1, options=OPTIONS)
    model = marln_of(load_checkpoint(tmp_path / "run" / "last.pt"))
    memory = model.begin(CARS)

    @torch.inference_mode()
    def learned(observation):
        nonlocal memory
        controls, memory = model.drive_on(observation, memory)
        return torch.stack([controls[:, 0], controls[:, 1] - controls[:, 2]], 1).numpy()

    # By chance 365, by chance among the network's actions 563, standing still about 460. Trainings of three seeds came
    # to 702, 736 and 571.
    assert mean_reward("marln", learned) > by_chance + 150.0
