"""CleanRL: one file with a loop over a vector of environments, here in the shape of its PPO for continuous actions."""

import gymnasium as gym
import numpy as np
import pytest
from ids import FLAT

torch = pytest.importorskip("torch")

from torch import nn
from torch.distributions.normal import Normal

STEPS, ENVS, GAMMA, LAMBDA = 16, 2, 0.99, 0.95


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


class Agent(nn.Module):
    def __init__(self, envs):
        super().__init__()
        inputs = int(np.prod(envs.single_observation_space.shape))
        outputs = int(np.prod(envs.single_action_space.shape))
        self.critic = nn.Sequential(nn.Linear(inputs, 8), nn.Tanh(), nn.Linear(8, 1))
        self.actor_mean = nn.Sequential(nn.Linear(inputs, 8), nn.Tanh(), nn.Linear(8, outputs))
        self.actor_logstd = nn.Parameter(torch.zeros(1, outputs))

    def get_action_and_value(self, x, action=None):
        probs = Normal(self.actor_mean(x), self.actor_logstd.exp())
        action = probs.sample() if action is None else action
        return action, probs.log_prob(action).sum(1), self.critic(x).flatten()


def test_ppo_for_continuous_actions() -> None:
    envs = gym.vector.SyncVectorEnv(
        [make_env(FLAT, GAMMA) for _ in range(ENVS)], autoreset_mode=gym.vector.AutoresetMode.SAME_STEP
    )
    assert isinstance(envs.single_action_space, gym.spaces.Box)
    agent = Agent(envs)
    optimizer = torch.optim.Adam(agent.parameters(), lr=3e-4, eps=1e-5)

    obs = torch.zeros((STEPS, ENVS, *envs.single_observation_space.shape))
    actions = torch.zeros((STEPS, ENVS, *envs.single_action_space.shape))
    logprobs, rewards, dones, values = (torch.zeros((STEPS, ENVS)) for _ in range(4))
    lengths = []

    next_obs, _ = envs.reset(seed=1)
    next_obs, next_done = torch.Tensor(next_obs), torch.zeros(ENVS)
    for step in range(STEPS):
        obs[step], dones[step] = next_obs, next_done
        with torch.no_grad():
            actions[step], logprobs[step], values[step] = agent.get_action_and_value(next_obs)
        next_obs, reward, terminations, truncations, infos = envs.step(actions[step].numpy())
        next_done = torch.Tensor(np.logical_or(terminations, truncations))
        rewards[step], next_obs = torch.tensor(reward), torch.Tensor(next_obs)
        if "final_info" in infos:
            episodes_over = np.nonzero(infos["final_info"]["_episode"])[0]
            lengths += infos["final_info"]["episode"]["l"][episodes_over].tolist()

    with torch.no_grad():
        next_value = agent.get_action_and_value(next_obs)[2]
        advantages, last = torch.zeros_like(rewards), 0.0
        for t in reversed(range(STEPS)):
            alive = 1.0 - (next_done if t == STEPS - 1 else dones[t + 1])
            following = next_value if t == STEPS - 1 else values[t + 1]
            delta = rewards[t] + GAMMA * following * alive - values[t]
            advantages[t] = last = delta + GAMMA * LAMBDA * alive * last
        returns = advantages + values

    _, newlogprob, newvalue = agent.get_action_and_value(obs.flatten(0, 1), actions.flatten(0, 1))
    ratio = (newlogprob - logprobs.flatten()).exp()
    assert torch.allclose(ratio, torch.ones_like(ratio), atol=1e-4)
    clipped = torch.clamp(ratio, 0.8, 1.2)
    loss = -torch.min(advantages.flatten() * ratio, advantages.flatten() * clipped).mean()
    loss = loss + ((newvalue - returns.flatten()) ** 2).mean()
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
    optimizer.step()

    assert torch.isfinite(loss)
    assert lengths == [6, 6, 6, 6]
    assert np.abs(obs.numpy()).max() <= 10
    envs.close()
