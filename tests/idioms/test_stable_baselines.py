"""Stable-Baselines3: train, look, save, load, evaluate; one environment."""

import os

import gymnasium as gym
import numpy as np
import pytest
from ids import DISCRETE, FLAT, PIXELS, SIM

pytest.importorskip("stable_baselines3")

from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.callbacks import (
    BaseCallback,
    CallbackList,
    CheckpointCallback,
    EvalCallback,
    EveryNTimesteps,
    StopTrainingOnMaxEpisodes,
)
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor, load_results
from stable_baselines3.common.noise import NormalActionNoise


def small():
    """A network that learns nothing, quickly."""
    return {"policy_kwargs": {"net_arch": [8]}, "device": "cpu"}


@pytest.mark.parametrize("env_id", [FLAT, DISCRETE, PIXELS])
def test_its_checker_without_a_warning(env_id: str) -> None:
    check_env(gym.make(env_id))


def test_its_checker_of_the_plain_environment_advises_symmetric_actions() -> None:
    with pytest.warns(UserWarning, match="symmetric and normalized Box action space"):
        check_env(gym.make(SIM))


def test_ppo_on_observations_of_several_keys() -> None:
    env = gym.make(SIM)
    model = PPO("MultiInputPolicy", env, n_steps=32, batch_size=32, n_epochs=1, **small())
    model.learn(total_timesteps=32)

    vec_env = model.get_env()
    obs = vec_env.reset()
    for _ in range(5):
        action, _states = model.predict(obs, deterministic=True)
        obs, rewards, dones, info = vec_env.step(action)
    assert info[0].keys() >= {"TimeLimit.truncated"}


def test_dqn_trained_saved_loaded_and_evaluated() -> None:
    env = gym.make(DISCRETE, render_mode="rgb_array", max_episode_steps=10)
    model = DQN("MlpPolicy", env, learning_starts=10, buffer_size=100, **small())
    model.learn(total_timesteps=30)
    model.save("dqn_wrongturn")
    del model

    model = DQN.load("dqn_wrongturn", env=env)
    mean_reward, std_reward = evaluate_policy(model, model.get_env(), n_eval_episodes=2)
    assert np.isfinite(mean_reward)
    assert model.get_env().render(mode="rgb_array").shape == (480, 864, 3)


def test_sac_with_its_replay_buffer_and_its_policy_by_itself() -> None:
    from stable_baselines3.sac.policies import MlpPolicy

    model = SAC("MlpPolicy", FLAT, learning_starts=10, buffer_size=100, **small())
    model.learn(total_timesteps=12)
    model.save("sac")
    model.save_replay_buffer("sac_replay_buffer")
    loaded_model = SAC.load("sac")
    loaded_model.load_replay_buffer("sac_replay_buffer")
    assert loaded_model.replay_buffer.size() == 12

    model.policy.save("sac_policy")
    saved_policy = MlpPolicy.load("sac_policy")
    observation = model.get_env().reset()
    assert np.allclose(
        saved_policy.predict(observation, deterministic=True)[0], model.predict(observation, deterministic=True)[0]
    )


def test_td3_with_noise_and_a_monitor_file() -> None:
    os.makedirs("log/", exist_ok=True)
    env = Monitor(gym.make(FLAT, max_episode_steps=5), "log/")
    n_actions = env.action_space.shape[-1]
    action_noise = NormalActionNoise(mean=np.zeros(n_actions), sigma=0.1 * np.ones(n_actions))
    model = TD3("MlpPolicy", env, action_noise=action_noise, learning_starts=5, buffer_size=100, **small())
    model.learn(total_timesteps=10)
    env.close()
    assert load_results("log/")["l"].tolist() == [5, 5]


def test_a_callback_that_evaluates_beside_the_training() -> None:
    env = gym.make(FLAT, max_episode_steps=5)
    eval_env = gym.make(FLAT, max_episode_steps=5)
    eval_callback = EvalCallback(
        Monitor(eval_env), best_model_save_path="./logs/", log_path="./logs/", eval_freq=10, n_eval_episodes=1
    )
    checkpoint_callback = CheckpointCallback(save_freq=10, save_path="./logs/")
    callback = CallbackList([checkpoint_callback, eval_callback])

    model = A2C("MlpPolicy", env, **small())
    model.learn(20, callback=callback)
    assert np.load("logs/evaluations.npz")["timesteps"].tolist() == [10, 20]
    A2C.load("logs/best_model")
    A2C.load("logs/rl_model_20_steps")


class Verdicts(BaseCallback):
    """Counts how episodes end."""

    def __init__(self) -> None:
        super().__init__()
        self.seen = []

    def _on_step(self) -> bool:
        self.seen += [info["verdict"] for info in self.locals["infos"] if "verdict" in info]
        return True


def test_callbacks_that_count_and_stop() -> None:
    verdicts = Verdicts()
    every = EveryNTimesteps(n_steps=5, callback=CheckpointCallback(save_freq=1, save_path="./logs/"))
    model = A2C("MlpPolicy", FLAT, n_steps=50, seed=1, **small())  # its first episode is short
    # Almost infinite, but the training stops with the first episode.
    model.learn(int(1e10), callback=[StopTrainingOnMaxEpisodes(max_episodes=1), verdicts, every])
    assert len(verdicts.seen) == 1
    A2C.load("logs/rl_model_5_steps")
