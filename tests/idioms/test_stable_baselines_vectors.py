"""Stable-Baselines3: vectors of environments and what is wrapped around them."""

import gymnasium as gym
import numpy as np
import pytest
from ids import FLAT, PIXELS, SIM

pytest.importorskip("stable_baselines3")

from gymnasium.wrappers import RescaleAction
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecCheckNan,
    VecExtractDictObs,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)


def small():
    return {"policy_kwargs": {"net_arch": [8]}, "device": "cpu"}


# CI has vectors of one process here and of many in test_gymnasium_vectors.py.
@pytest.mark.parametrize("kind", [DummyVecEnv, pytest.param(SubprocVecEnv, marks=pytest.mark.soak)])
def test_make_vec_env(kind) -> None:
    vec_env = make_vec_env(FLAT, n_envs=2, seed=0, vec_env_cls=kind)
    model = PPO("MlpPolicy", vec_env, n_steps=16, batch_size=32, n_epochs=1, **small())
    model.learn(total_timesteps=32)

    obs = vec_env.reset()
    for _ in range(5):
        action, _states = model.predict(obs)
        obs, rewards, dones, info = vec_env.step(action)
    assert rewards.shape == dones.shape == (2,)
    assert vec_env.render().ndim == 3, "one picture with both"
    vec_env.close()


@pytest.mark.filterwarnings("ignore:.*precision lowered by casting")  # Gymnasium's, for every float32 space
def test_make_vec_env_with_a_wrapper_and_arguments() -> None:
    vec_env = make_vec_env(
        SIM,
        n_envs=2,
        wrapper_class=RescaleAction,
        wrapper_kwargs={"min_action": -1.0, "max_action": 1.0},
        env_kwargs={"town": "junctions"},
    )
    assert vec_env.action_space.low.tolist() == [-1, -1, -1]
    vec_env.reset()
    assert [info["town"] for info in vec_env.reset_infos] == ["junctions"] * 2
    vec_env.close()


def test_normalized_saved_and_loaded() -> None:
    vec_env = make_vec_env(FLAT, n_envs=1)
    vec_env = VecNormalize(vec_env, norm_obs=True, norm_reward=True, clip_obs=10.0)
    model = PPO("MlpPolicy", vec_env, n_steps=16, batch_size=16, n_epochs=1, **small())
    model.learn(total_timesteps=16)
    model.save("ppo_wrongturn")
    vec_env.save("vec_normalize.pkl")

    vec_env = make_vec_env(FLAT, n_envs=1)
    vec_env = VecNormalize.load("vec_normalize.pkl", vec_env)
    vec_env.training = False
    vec_env.norm_reward = False
    model = PPO.load("ppo_wrongturn", env=vec_env)
    assert np.abs(vec_env.reset()).max() <= 10
    assert vec_env.obs_rms.count > 16


def test_normalized_keys_of_observations() -> None:
    vec_env = VecNormalize(make_vec_env(SIM, n_envs=1), norm_obs_keys=["speed"])
    assert vec_env.reset().keys() == {"speed", "steering", "command"}


def test_stacked_pictures_and_a_cnn() -> None:
    vec_env = make_vec_env(PIXELS, n_envs=2, seed=0)
    vec_env = VecFrameStack(vec_env, n_stack=4)
    model = A2C("CnnPolicy", vec_env, n_steps=2, policy_kwargs={"features_extractor_kwargs": {"features_dim": 8}})
    model.learn(total_timesteps=4)
    assert vec_env.reset().shape == (2, 64, 192, 12)
    vec_env.close()


def test_monitors_and_checks_for_nan() -> None:
    vec_env = DummyVecEnv([lambda: gym.make(FLAT, max_episode_steps=3)])
    vec_env = VecCheckNan(vec_env, raise_exception=True)
    vec_env = VecMonitor(vec_env, "monitor.csv")
    vec_env.reset()
    for _ in range(3):
        _, _, dones, infos = vec_env.step(np.zeros((1, 2)))
    assert dones.all()
    assert infos[0]["episode"]["l"] == 3
    assert "terminal_observation" in infos[0]
    vec_env.close()


def test_one_key_of_the_observation() -> None:
    env = DummyVecEnv([lambda: gym.make(SIM)])
    env = VecExtractDictObs(env, key="speed")
    assert env.reset().shape == (1, 1)


def test_attributes_methods_seeds_and_options() -> None:
    vec_env = make_vec_env(SIM, n_envs=1, env_kwargs={"suite": "smoke@3"})
    assert vec_env.get_attr("render_mode") == ["rgb_array"]
    assert vec_env.env_method("get_wrapper_attr", "track") == ["state"]
    vec_env.seed(3)
    vec_env.reset()
    trial = vec_env.reset_infos[0]["trial"]
    vec_env.set_options({"trial": trial})
    vec_env.reset()
    assert vec_env.reset_infos[0]["trial"] == trial
