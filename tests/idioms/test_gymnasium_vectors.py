"""Gymnasium: many environments at once, in one process, in several, and as one batch.

``test_cleanrl.py`` makes them of a list of functions.
"""

import gymnasium as gym
import numpy as np
from ids import SIM


def test_make_vec_in_several_processes() -> None:
    envs = gym.make_vec(SIM, num_envs=2, vectorization_mode="async")
    envs.reset(seed=42)
    for _ in range(3):
        observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
    assert observations["speed"].shape == (2, 1)
    assert rewards.shape == terminations.shape == truncations.shape == (2,)
    envs.close()


def test_make_vec_with_wrappers() -> None:
    envs = gym.make_vec(
        SIM, num_envs=2, vectorization_mode="sync", wrappers=(gym.wrappers.FlattenObservation, gym.wrappers.ClipAction)
    )
    observations, _ = envs.reset(seed=42)
    assert observations.shape == (2, 3)
    envs.close()


def test_wrappers_of_vectors() -> None:
    envs = gym.make_vec(SIM, num_envs=4)
    envs = gym.wrappers.vector.RecordEpisodeStatistics(envs)
    envs = gym.wrappers.vector.FlattenObservation(envs)
    envs = gym.wrappers.vector.NormalizeObservation(envs)
    envs = gym.wrappers.vector.NormalizeReward(envs)
    envs = gym.wrappers.vector.ClipAction(envs)
    observations, _ = envs.reset(seed=1)
    for _ in range(3):
        observations, rewards, *_ = envs.step(envs.action_space.sample())
    assert observations.shape == (4, 3)
    assert np.isfinite(rewards).all()
    envs.close()


def test_infos_as_lists() -> None:
    envs = gym.wrappers.vector.DictInfoToList(gym.make_vec(SIM, num_envs=2, vectorization_mode="sync"))
    _, infos = envs.reset(seed=1)
    assert [info["town"] for info in infos] == ["Town01"] * 2
    envs.close()
