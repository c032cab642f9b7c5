"""RLlib: ``register_env`` and a training step. Ray asks for one older version of Gymnasium, so CI does not have it."""

import gymnasium as gym
import pytest
from ids import FLAT

ray = pytest.importorskip("ray", reason="Ray is not installed beside this version of Gymnasium")

pytestmark = [pytest.mark.soak, pytest.mark.filterwarnings("default")]


def test_register_env_and_train() -> None:
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.tune.registry import register_env

    def env_creator(env_config):
        return gym.make(FLAT, **env_config)

    register_env("wrongturn", env_creator)
    config = (
        PPOConfig()
        .environment("wrongturn", env_config={"town": "junctions"})
        .env_runners(num_env_runners=0, rollout_fragment_length=32)
        .training(train_batch_size_per_learner=32, minibatch_size=32, num_epochs=1)
    )
    algo = config.build_algo()
    try:
        result = algo.train()
        assert result["env_runners"]["num_env_steps_sampled"] >= 32
    finally:
        algo.stop()
        ray.shutdown()
