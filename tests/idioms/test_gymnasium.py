"""Gymnasium: make, drive, check, wrap. Statistics, and what is normalised, are in ``test_cleanrl.py``."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from ids import DISCRETE, FLAT, PIXELS, SIM


def test_the_loop_of_basic_usage() -> None:
    env = gym.make(SIM)
    observation, info = env.reset()

    episode_over = False
    while not episode_over:
        action = env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)

        episode_over = terminated or truncated

    env.close()
    assert observation in env.observation_space
    assert info["verdict"]


def test_import_the_package_and_make_by_the_short_id() -> None:
    import wrongturn_sim

    gym.register_envs(wrongturn_sim)
    env = gym.make("WrongturnSim-v0")
    again = gym.make(env.spec)
    assert again.spec == env.spec
    assert gym.spec("WrongturnSim-v0").id == env.spec.id == "WrongturnSim-v0"


def test_a_time_limit_given_to_make() -> None:
    env = gym.make(SIM, max_episode_steps=5)
    env.reset(seed=1)
    ends = [env.step(env.action_space.sample())[3] for _ in range(5)]
    assert ends == [False] * 4 + [True]


def test_an_own_id_with_arguments_in_it() -> None:
    gym.register(
        id="MyTown-v0",
        entry_point="wrongturn_sim.gym_env:WrongturnSimEnv",
        max_episode_steps=300,
        kwargs={"town": "junctions", "fault": "omission"},
    )
    try:
        env = gym.make("MyTown-v0")
        _, info = env.reset(seed=1)
        assert (info["town"], env.spec.max_episode_steps) == ("junctions", 300)
    finally:
        del gym.registry["MyTown-v0"]


def test_collected_pictures() -> None:
    env = gym.make(SIM, render_mode="rgb_array_list")
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert [picture.shape for picture in env.render()] == [(480, 864, 3)] * 2


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
@pytest.mark.parametrize("env_id", [FLAT, DISCRETE, PIXELS])
def test_its_checker_of_ids_with_wrappers(env_id: str) -> None:
    check_env(gym.make(env_id))


GO = np.array([0.0, 1.0, 0.0], np.float32)
wrappers = gym.wrappers


def row(env):
    return env.unwrapped.episode.trajectory.rows[-1]


@pytest.mark.parametrize(
    ("wrap", "right"),
    [
        (wrappers.FlattenObservation, lambda env, seen: seen.shape == env.observation_space.shape == (3,)),
        (
            lambda env: wrappers.FilterObservation(env, filter_keys=["speed"]),
            lambda env, seen: seen.keys() == {"speed"},
        ),
        (
            lambda env: wrappers.TransformObservation(
                env, lambda obs: obs["speed"] * 3.6, gym.spaces.Box(0.0, 80.0, (1,), np.float32)
            ),
            lambda env, seen: seen == pytest.approx(row(env).v * 3.6),
        ),
        (
            lambda env: wrappers.FrameStackObservation(env, stack_size=4),
            lambda env, seen: seen["speed"].shape == (4, 1) and seen["speed"][2] < seen["speed"][3],
        ),
        (
            lambda env: wrappers.AddRenderObservation(env, render_only=True),
            lambda env, seen: np.array_equal(seen, env.render()),
        ),
        (lambda env: wrappers.RepeatAction(env, num_repeats=4), lambda env, seen: row(env).t == pytest.approx(0.4)),
        (lambda env: wrappers.StickyAction(env, repeat_action_probability=0.9), lambda env, seen: row(env).t > 0),
        (
            lambda env: wrappers.TimeAwareObservation(wrappers.FlattenObservation(wrappers.TimeLimit(env, 10))),
            lambda env, seen: seen[-1] == 1,
        ),
        (
            lambda env: wrappers.DelayObservation(wrappers.FlattenObservation(env), delay=2),
            lambda env, seen: not seen.any(),
        ),
    ],
)
def test_wrappers_of_observations_and_actions(wrap, right) -> None:
    env = wrap(gym.make(SIM, render_mode="rgb_array"))
    env.reset(seed=1)
    observation, *_ = env.step(GO)
    assert right(env, observation)


def test_gray_small_stacked_pictures() -> None:
    env = wrappers.GrayscaleObservation(gym.make(PIXELS))
    env = wrappers.FrameStackObservation(wrappers.ResizeObservation(env, (84, 84)), stack_size=4)
    observation, _ = env.reset(seed=1)
    assert (observation.shape, observation.dtype) == ((4, 84, 84), np.uint8)
    assert observation.std() > 1


@pytest.mark.parametrize(
    ("wrap", "action", "driven"),
    [
        (lambda env: wrappers.RescaleAction(env, min_action=-1, max_action=1), [0.0, 1.0, -1.0], (0.0, 1.0, 0.0)),
        (wrappers.ClipAction, [7.0, -3.0, 0.0], (1.0, 0.0, 0.0)),
        (lambda env: wrappers.DiscretizeAction(env, bins=(5, 2, 2), multidiscrete=True), [2, 1, 0], (0.0, 0.75, 0.25)),
    ],
)
def test_wrappers_that_change_the_action(wrap, action, driven) -> None:
    env = wrap(gym.make(SIM))
    env.reset(seed=1)
    env.step(np.array(action, env.action_space.dtype))
    assert (row(env).steer, row(env).throttle, row(env).brake) == pytest.approx(driven, abs=1e-6)


class SlowDown(gym.RewardWrapper):
    def reward(self, reward):
        return -abs(reward)


class NoBrake(gym.ActionWrapper):
    def __init__(self, env):
        super().__init__(env)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def action(self, action):
        return np.array([action[0], abs(action[1]), 0.0], np.float32)


def test_wrappers_of_ones_own() -> None:
    env = SlowDown(NoBrake(gym.make(SIM)))
    env.reset(seed=1)
    _, reward, *_ = env.step(env.action_space.sample())
    assert reward <= 0
    assert env.unwrapped.episode.trajectory.rows[-1].brake == 0.0
