"""Any number of environments in one process: with and without traffic, at the same time, and gone at their end."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from wrongturn_protocol import Track
from wrongturn_sim import Episode, SimulatorFailedError, WrongturnSimEnv

ID = "wrongturn_sim:WrongturnSim-v0"
TRAFFIC = {"vehicles": 12, "pedestrians": 8}
STEPS = 25


def action(step):
    return np.float32([0.03 * np.sin(step), 0.2, 0.0])


def driven(env, seed):
    """Return what an environment shows and keeps of a short drive, as bytes."""
    seen, _ = env.reset(seed=seed)
    shown = [seen]
    for step in range(STEPS):
        seen, _, terminated, truncated, _ = env.step(action(step))
        shown.append(seen)
        if terminated or truncated:
            break
    return [{name: array.tobytes() for name, array in seen.items()} for seen in shown], record_of(env.unwrapped.episode)


def record_of(episode):
    return episode.trajectory.to_json(), episode.actions_sha256


def children():
    """Return the processes that this one has started."""
    return {int(pid) for task in Path("/proc/self/task").iterdir() for pid in (task / "children").read_text().split()}


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.parametrize("traffic", [{}, TRAFFIC], ids=["alone", "traffic"])
def test_all_give_the_bytes_of_an_episode_in_sumo(traffic):
    envs = [WrongturnSimEnv("junctions", "privileged", traffic=traffic) for _ in range(2)]
    shown = [driven(env, seed=3) for env in envs]
    assert shown[0] == shown[1]
    trial, steps = envs[0].episode.trial, envs[0].episode.steps
    for env in envs:
        env.close()
    episode = Episode(trial, Track.PRIVILEGED)
    episode.reset()
    for step in range(steps):
        episode.step(*action(step).tolist())
    assert record_of(episode) == shown[0][1]
    assert any(row.road_users for row in episode.trajectory.rows) == bool(traffic)


def test_they_take_turns_without_disturbing_each_other():
    """Pictures too, and the route that SUMO's drivers are told when the car leaves its own."""
    options = {"town": "junctions", "track": "camera", "traffic": TRAFFIC}
    alone = WrongturnSimEnv(**options)
    wanted = [driven(alone, seed)[1] for seed in (5, 6, 7)]
    seen = {name: array.tobytes() for name, array in alone.step(action(STEPS))[0].items()}
    alone.close()
    envs = [WrongturnSimEnv(**options) for _ in range(3)]
    for env, seed in zip(envs, (5, 6, 7), strict=True):
        env.reset(seed=seed)
    for step in range(STEPS):
        for env in envs:
            env.step(action(step))
    assert [record_of(env.episode) for env in envs] == wanted
    last = envs[2].step(action(STEPS))[0]
    assert {name: array.tobytes() for name, array in last.items()} == seen
    for env in envs:
        env.close()


def test_the_second_with_traffic_has_a_process_that_ends_with_it():
    before = children()
    first, second = (WrongturnSimEnv("junctions", traffic=TRAFFIC) for _ in range(2))
    first.reset(seed=1)
    assert children() == before, "the first takes this process's simulator"
    second.reset(seed=1)
    (pid,) = children() - before
    second.step(action(0))
    second.close()
    second.close()
    assert not is_alive(pid)
    second.reset(seed=1)
    second.step(action(0))
    (pid,) = children() - before
    del second
    assert not is_alive(pid), "nobody keeps it any more"
    first.close()
    third = WrongturnSimEnv("junctions", traffic=TRAFFIC)
    third.reset(seed=1)
    assert children() == before, "the first one's simulator is free"


def test_a_process_that_dies_is_told_and_the_next_reset_gets_another():
    before = children()
    first, second = (WrongturnSimEnv("junctions", traffic=TRAFFIC) for _ in range(2))
    for env in (first, second):
        env.reset(seed=1)
    (pid,) = children() - before
    os.kill(pid, signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(SimulatorFailedError, match="reset the environment"):
            second.step(action(0))
    first.step(action(0))
    assert driven(second, 2)[1] == driven(first, 2)[1]
    for env in (first, second):
        env.close()


def test_one_that_drives_alone_needs_no_sumo():
    code = (
        "import sys; sys.modules['libsumo'] = None\n"
        "import numpy, wrongturn_sim\n"
        "env = wrongturn_sim.WrongturnSimEnv('junctions')\n"
        "env.reset(seed=1); env.step(numpy.zeros(3))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


CRASH = """
import os, signal
from wrongturn_sim import WrongturnSimEnv
envs = [WrongturnSimEnv("junctions", traffic={"vehicles": 2}) for _ in range(2)]
for env in envs:
    env.reset(seed=1)
print(os.getpid(), flush=True)
signal.pause()
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_nothing_is_left_after_a_crash_or_an_interrupt(how):
    with subprocess.Popen(
        [sys.executable, "-c", CRASH], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as program:
        pid = int(program.stdout.readline())
        (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        assert is_alive(child)
        program.send_signal(how)
    end = time.monotonic() + 120.0
    while is_alive(child):
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasium_makes_vectors_of_them(mode):
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, town="junctions", track="privileged")
    try:
        first, _ = envs.reset(seed=[1, 1])
        for step in range(5):
            seen, *_ = envs.step(np.stack([action(step)] * 2))
        assert (seen["pose"][0] == seen["pose"][1]).all()
        assert (seen["pose"] != first["pose"]).any()
    finally:
        envs.close()


def test_stable_baselines_makes_vectors_and_evaluates_beside_the_training():
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.env_util import make_vec_env

    made = {"town": "junctions", "traffic": {"vehicles": 2}}
    envs = make_vec_env(ID, n_envs=2, seed=1, env_kwargs=made)
    callback = EvalCallback(
        make_vec_env(ID, env_kwargs={**made, "max_episode_steps": 4}), n_eval_episodes=1, eval_freq=4
    )
    model = sb3.PPO("MultiInputPolicy", envs, n_steps=4, batch_size=8, n_epochs=1, device="cpu", seed=1)
    model.learn(8, callback)
    assert np.isfinite(callback.last_mean_reward)
    assert envs.render("rgb_array").shape[2] == 3
    callback.eval_env.close()
    envs.close()
