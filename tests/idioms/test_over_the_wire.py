"""The same idioms with a service in between."""

import gymnasium as gym
import pytest
from ids import WIRE_FLAT

pytestmark = pytest.mark.usefixtures("over_the_wire")


def test_stable_baselines_over_the_wire() -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.env_util import make_vec_env

    env = gym.make(WIRE_FLAT)
    check_env(env)
    env.close()
    vec_env = make_vec_env(WIRE_FLAT, n_envs=2, seed=0, env_kwargs={"render_mode": "rgb_array"})
    eval_env = make_vec_env(WIRE_FLAT, env_kwargs={"max_episode_steps": 4})
    callback = EvalCallback(eval_env, n_eval_episodes=1, eval_freq=4)
    model = PPO("MlpPolicy", vec_env, n_steps=8, batch_size=16, n_epochs=1, device="cpu")
    model.learn(total_timesteps=16, callback=callback)
    assert callback.last_mean_reward > -float("inf")
    assert vec_env.render().ndim == 3
    vec_env.close()
    eval_env.close()
