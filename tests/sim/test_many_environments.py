"""Any number of environments in one process: with and without traffic, at the same time, and gone at their end."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from wrongturn_protocol import Track
from wrongturn_sim import Episode, SimulatorFailedError, SimulatorInUseError, WrongturnSimEnv, simulator_process

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
    return {child.pid for child in psutil.Process().children()}


def is_alive(pid):
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


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
    """The pictures have the same bytes too."""
    options = {"town": "junctions", "track": "camera", "traffic": TRAFFIC}
    alone = WrongturnSimEnv(**options)
    wanted = [driven(alone, seed)[1] for seed in (5, 6)]
    seen = {name: array.tobytes() for name, array in alone.step(action(STEPS))[0].items()}
    alone.close()
    envs = [WrongturnSimEnv(**options) for _ in range(2)]
    for env, seed in zip(envs, (5, 6), strict=True):
        env.reset(seed=seed)
    for step in range(STEPS):
        for env in envs:
            env.step(action(step))
    assert [record_of(env.episode) for env in envs] == wanted
    last = envs[1].step(action(STEPS))[0]
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
    old = second.episode
    second.reset(seed=2)
    with pytest.raises(SimulatorInUseError, match="drives another episode now"):
        old.step(0.0, 0.2, 0.0)
    second.close()
    second.close()
    assert not is_alive(pid)
    second.reset(seed=1)
    (pid,) = children() - before
    del second, old
    assert not is_alive(pid), "nobody keeps it any more"
    first.close()
    third = WrongturnSimEnv("junctions", traffic=TRAFFIC)
    third.reset(seed=1)
    assert children() == before, "the first one's simulator is free"


def test_a_fork_is_told_and_does_not_disturb_its_parent():
    first, second = (WrongturnSimEnv("junctions", traffic=TRAFFIC) for _ in range(2))
    for env in (first, second):
        env.reset(seed=1)
    child = os.fork()
    if child == 0:
        told = False
        try:
            second.step(action(0))
        except SimulatorInUseError as error:
            told = "reset the environment here" in str(error)
        finally:
            os._exit(0 if told else 1)
    for step in range(5):
        for env in (first, second):
            env.step(action(step))
    assert os.waitpid(child, 0)[1] == 0
    assert record_of(first.episode) == record_of(second.episode)
    for env in (first, second):
        env.close()


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["dies", "is interrupted"])
def test_a_process_that_dies_or_is_interrupted_is_told_and_the_next_reset_gets_another(how, monkeypatch):
    monkeypatch.setattr(simulator_process, "_GOODBYE", 0.01)
    before = children()
    first, second = (WrongturnSimEnv("junctions", traffic=TRAFFIC) for _ in range(2))
    for env in (first, second):
        env.reset(seed=1)
    (pid,) = children() - before
    os.kill(pid, how)
    if how == signal.SIGSTOP:  # so that the interrupt meets a step that waits for its reply
        handler = signal.signal(signal.SIGALRM, interrupt)
        signal.setitimer(signal.ITIMER_REAL, 0.5)
        with pytest.raises(KeyboardInterrupt):
            second.step(action(0))
        signal.signal(signal.SIGALRM, handler)
    for _ in range(2):
        with pytest.raises(SimulatorFailedError, match="reset the environment"):
            second.step(action(0))
    assert not is_alive(pid)
    first.step(action(0))
    assert driven(second, 2)[1] == driven(first, 2)[1]
    for env in (first, second):
        env.close()


CRASH = """
import os, signal
from wrongturn_sim import WrongturnSimEnv
envs = [WrongturnSimEnv("junctions", traffic={"vehicles": 2}) for _ in range(2)]
for env in envs:
    env.reset(seed=1)
print(os.getpid(), flush=True)
signal.pause()
"""


def test_nothing_is_left_after_a_crash():
    with subprocess.Popen(
        [sys.executable, "-c", CRASH], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as program:
        pid = int(program.stdout.readline())
        (child,) = (child.pid for child in psutil.Process(pid).children())
        assert is_alive(child)
        program.kill()
    end = time.monotonic() + 120.0
    while is_alive(child):
        assert time.monotonic() < end
        time.sleep(0.02)
