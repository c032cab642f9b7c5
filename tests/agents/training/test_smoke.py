"""A short training on the CPU, as continuous integration runs it: what it learns must be worth something."""

import numpy as np
import pytest
import torch

from wrongturn_agents.training.checkpoint import load_checkpoint, model_of
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.train import train
from wrongturn_protocol import TRAINING_WEATHERS

OPTIONS = (
    "num_envs=16",
    "n_steps=32",
    "batch_size=128",
    "n_epochs=4",
    "learning_rate=1e-3",
    "time_limit=15",
    "journeys=1",
    "brief_journeys=1",
    "patience=3",
    # In so few steps what is learnt first is not to leave the road: that is what these reward.
    "activation=relu",
    "accelerate=0",
    "failure_penalty=2",
    "standing_penalty=2",
    "standing_cost=0",
)


def mean_reward(act, episodes=32):
    """Of an episode of the paper's reward, of drives of at most 15 s that are not trained on."""
    envs = DrivingVecEnv(
        16,
        keys=("speed", "steering", "command", "segmentation"),
        town="Town01",
        track="segmentation",
        task="cruise",
        strict=True,
        record=False,
        weather=TRAINING_WEATHERS,
        journeys={"time_limit": 15.0},
    )
    envs.seed(10**6)
    observation = envs.reset()
    rewards = []
    while len(rewards) < episodes:
        observation, _, _, infos = envs.step(act(observation))
        rewards += [info["episode"]["r"] for info in infos if info]
    envs.close()
    return float(np.mean(rewards))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_two_minute_training_beats_a_random_policy(tmp_path):
    random = np.random.default_rng(1)
    by_chance = mean_reward(lambda _: random.uniform(-1.0, 1.0, (16, 2)))
    train("ppo-segmentation", directory=tmp_path, seed=1, steps=8192, device="cpu", options=OPTIONS)
    model = model_of(load_checkpoint(tmp_path / "last.pt"))

    @torch.inference_mode()
    def learnt(observation):
        return model.act(model.features(observation), observation["command"]).numpy()

    # 750 by chance and 1,582 after it, when this was written.
    assert mean_reward(learnt) > by_chance + 300.0
