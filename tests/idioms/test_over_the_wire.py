"""The same idioms with a service in between."""

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env
from ids import WIRE, WIRE_FLAT

pytestmark = pytest.mark.usefixtures("over_the_wire")


def test_the_loop_of_basic_usage_over_the_wire() -> None:
    env = gym.make(WIRE, max_episode_steps=5)
    observation, info = env.reset(seed=42)

    episode_over = False
    while not episode_over:
        action = env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)

        episode_over = terminated or truncated

    env.close()
    assert observation in env.observation_space


def test_gymnasiums_checker_over_the_wire() -> None:
    env = gym.make(WIRE)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_render_over_the_wire() -> None:
    env = gym.make(WIRE, render_mode="rgb_array")
    env.reset(seed=1)
    assert env.render().shape == (480, 864, 3)
    env.close()


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
def test_make_vec_over_the_wire(mode: str) -> None:
    envs = gym.make_vec(WIRE, num_envs=2, vectorization_mode=mode)
    envs.reset(seed=42)
    observations, *_ = envs.step(envs.action_space.sample())
    assert observations["speed"].shape == (2, 1)
    envs.close()


def test_stable_baselines_over_the_wire() -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env as check
    from stable_baselines3.common.env_util import make_vec_env

    env = gym.make(WIRE_FLAT)
    check(env)
    env.close()
    vec_env = make_vec_env(WIRE_FLAT, n_envs=2, seed=0, env_kwargs={"render_mode": "rgb_array"})
    model = PPO("MlpPolicy", vec_env, n_steps=8, batch_size=16, n_epochs=1, device="cpu")
    model.learn(total_timesteps=16)
    assert vec_env.render().ndim == 3
    vec_env.close()
