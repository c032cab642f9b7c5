"""CleanRL: one file with a loop over a vector of environments, here the rollout of its PPO for continuous actions.

``docs/examples/one_file_ppo.py`` is the whole PPO.
"""

import gymnasium as gym
import numpy as np
import pytest
from ids import FLAT

torch = pytest.importorskip("torch")

from torch.distributions.normal import Normal

STEPS, ENVS, GAMMA = 16, 2, 0.99


def make_env(env_id, gamma):
    def thunk():
        env = gym.make(env_id, max_episode_steps=6)
        env = gym.wrappers.FlattenObservation(env)
        env = gym.wrappers.RecordEpisodeStatistics(env)
        env = gym.wrappers.ClipAction(env)
        env = gym.wrappers.NormalizeObservation(env)
        env = gym.wrappers.TransformObservation(env, lambda obs: np.clip(obs, -10, 10), env.observation_space)
        env = gym.wrappers.NormalizeReward(env, gamma=gamma)
        return gym.wrappers.TransformReward(env, lambda reward: np.clip(reward, -10, 10))

    return thunk


def test_the_rollout_of_ppo_for_continuous_actions() -> None:
    envs = gym.vector.SyncVectorEnv(
        [make_env(FLAT, GAMMA) for _ in range(ENVS)], autoreset_mode=gym.vector.AutoresetMode.SAME_STEP
    )
    assert isinstance(envs.single_action_space, gym.spaces.Box)
    shape, outputs = envs.single_observation_space.shape, envs.single_action_space.shape
    actor_mean = torch.nn.Linear(int(np.prod(shape)), int(np.prod(outputs)))
    obs = torch.zeros((STEPS, ENVS, *shape))
    rewards, dones = torch.zeros((STEPS, ENVS)), torch.zeros((STEPS, ENVS))
    lengths = []

    next_obs, _ = envs.reset(seed=1)
    next_obs, next_done = torch.Tensor(next_obs), torch.zeros(ENVS)
    for step in range(STEPS):
        obs[step], dones[step] = next_obs, next_done
        with torch.no_grad():
            action = Normal(actor_mean(next_obs), 1.0).sample()
        next_obs, reward, terminations, truncations, infos = envs.step(action.numpy())
        next_done = torch.Tensor(np.logical_or(terminations, truncations))
        rewards[step], next_obs = torch.tensor(reward), torch.Tensor(next_obs)
        if "final_info" in infos:
            episodes_over = np.nonzero(infos["final_info"]["_episode"])[0]
            lengths += infos["final_info"]["episode"]["l"][episodes_over].tolist()

    assert lengths == [6, 6, 6, 6]
    assert dones.sum() == 4
    assert obs.abs().max() <= 10
    assert torch.isfinite(rewards).all()
    envs.close()
