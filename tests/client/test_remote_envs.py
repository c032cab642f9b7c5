"""The environments over the wire of a real service: what breaks, what is full, and who goes on."""

import os
import pickle
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from typing import Any

import gymnasium
import httpx
import numpy as np
import pytest
from client_forwarder import Forwarder
from gymnasium.error import ResetNeeded

from wrongturn_client import (
    ApiError,
    LocalService,
    RemoteEnv,
    RemoteVectorEnv,
    ServiceFullError,
    ServiceUnreachableError,
    WrongturnError,
)

GAS = np.float32([0.1, 0.8, 0.0])
STEPS = 'wrongturn_request_seconds_count{method="POST",route="/v1/episodes/{episode}/step"'


def _gas(number: int) -> Any:
    return np.tile(GAS, (number, 1))


def _figure(url: str, name: str) -> float:
    lines = httpx.get(url + "/metrics", timeout=60).text.splitlines()
    return sum(float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith(name))


@pytest.fixture
def forwarder(service: LocalService) -> Iterator[Forwarder]:
    forwarder = Forwarder(service.url)
    yield forwarder
    forwarder.close()


def test_a_batch_is_what_single_environments_are(service: LocalService) -> None:
    """Both over the socket, and over HTTP where it is not offered; seeds, autoreset and verdicts too."""
    before = _figure(service.url, STEPS)
    options = {"url": service.url, "town": "junctions", "track": "privileged", "fault": "omission"}
    envs = gymnasium.make_vec("wrongturn_client:Wrongturn-v0", num_envs=2, autoreset_mode="Disabled", **options)
    seen = [envs.reset(seed=4)[0]]
    ended: dict[int, tuple[int, str]] = {}
    rewards = []
    while len(ended) < 1:
        observation, reward, terminated, truncated, infos = envs.step(_gas(2))
        seen.append(observation)
        rewards.append(reward)
        for i in np.flatnonzero(terminated | truncated).tolist():
            ended[i] = (len(seen) - 1, infos["verdict"][i])
    envs.close()
    assert _figure(service.url, STEPS) == before, "it went by the socket"
    for i in range(2):
        env = RemoteEnv(**options)  # type: ignore[arg-type]
        first, _ = env.reset(seed=4 + i)
        _same(first, seen[0], i)
        for number, batch in enumerate(seen[1:], 1):
            observation, reward, terminated, truncated, info = env.step(GAS)
            _same(observation, batch, i)
            assert reward == rewards[number - 1][i]
            assert (terminated or truncated) == (ended.get(i, (0, ""))[0] == number)
        if i in ended:
            assert info["verdict"] == ended[i][1]
        env.close()
    assert _figure(service.url, "wrongturn_open_episodes") == 0


def _same(one: dict[str, Any], batch: dict[str, Any], i: int) -> None:
    assert one.keys() == batch.keys()
    for name, array in one.items():
        assert array.dtype == batch[name].dtype
        np.testing.assert_array_equal(array, batch[name][i])


def test_the_service_says_what_is_wrong_with_a_name(service: LocalService) -> None:
    for options, says in (
        ({"fault": "stuck"}, "fault.kind: stuck is not built yet; take one of none, infeasible, omission"),
        ({"town": "Town1"}, "town: 'Town1' is not known; there are: .*Did you mean Town01"),
        ({"town": "Town01", "approach": "J9-X"}, "approach: 'J9-X' is not known; there are: .*Did you mean J9-"),
    ):
        env = RemoteEnv(service.url, **options)  # type: ignore[arg-type]
        with pytest.raises(ApiError, match=says):
            env.reset()
        env.close()


def test_a_connection_that_breaks_costs_no_step(forwarder: Forwarder, service: LocalService) -> None:
    """Driven twice or not at all, an episode would not look as it does over a line that holds."""
    seen = []
    for url in (forwarder.url, service.url):
        envs = RemoteVectorEnv(2, url, town="junctions", track="segmentation")
        seen.append([envs.reset(seed=8)[0]])
        for number in range(30):
            if url == forwarder.url and number % 6 == 2:
                forwarder.cut()
            elif url == forwarder.url and number % 6 == 5:
                forwarder.cut_after = 0
            seen[-1].append(envs.step(_gas(2))[0])
        envs.close()
    assert forwarder.plugged > 10
    for one, other in zip(*seen, strict=True):
        for name, array in one.items():
            np.testing.assert_array_equal(array, other[name])


@pytest.mark.parametrize("many", [False, True])
def test_threads_that_use_one_environment_at_a_time_are_told(forwarder: Forwarder, many: bool) -> None:
    env: Any = RemoteVectorEnv(2, forwarder.url) if many else RemoteEnv(forwarder.url)
    action = _gas(2) if many else GAS
    with closing(env), ThreadPoolExecutor(1) as other:
        env.reset(seed=1)
        with forwarder.keeping():
            step = other.submit(env.step, action)
            assert forwarder.kept.wait(60), "the step is not under way"
            for call in (lambda: env.step(action), lambda: env.reset(seed=2)):
                with pytest.raises(WrongturnError, match="used by two threads at a time; make one for each thread"):
                    call()
        step.result()
        env.step(action)  # in turns


def test_an_environment_can_be_sent_to_another_process(service: LocalService) -> None:
    with pickle.loads(pickle.dumps(RemoteEnv(service.url))) as env:
        env.reset(seed=1)
        env.step(GAS)


@pytest.fixture
def small(tmp_path: Any) -> Iterator[dict[str, Any]]:
    """How to start a service with two simulators."""
    return {
        "database": f"sqlite+aiosqlite:///{tmp_path / 'wrongturn.db'}",
        "environment": {"WRONGTURN_SIMULATORS": "2"},
    }


@pytest.mark.slow
def test_more_environments_than_simulators_and_a_service_that_is_killed(small: dict[str, Any]) -> None:
    with ExitStack() as stack:
        first = stack.enter_context(LocalService(**small))
        too_many = stack.enter_context(closing(RemoteVectorEnv(3, first.url)))
        with pytest.raises(ServiceFullError, match=r"has 2 simulators; make 2 environments at most"):
            too_many.reset(seed=1)
        envs = stack.enter_context(closing(RemoteVectorEnv(2, first.url)))
        envs.reset(seed=1)
        envs.step(_gas(2))
        os.kill(first.pid, signal.SIGKILL)
        first.stop()
        with RemoteEnv(first.url, patience=0.0) as env, pytest.raises(ServiceUnreachableError, match="wrongturn serve"):
            env.reset()
        stack.enter_context(LocalService(**small, port=int(first.url.rpartition(":")[2])))
        _, rewards, _, truncated, infos = envs.step(_gas(2))
        assert truncated.all()
        assert not rewards.any()
        assert all("lost" in why or "again" in why for why in infos["lost"])
        _, _, _, truncated, infos = envs.step(_gas(2))
        assert infos["_trial"].all()
        _, _, _, truncated, _ = envs.step(_gas(2))
        assert not truncated.any()
        envs.close()
        assert _figure(first.url, "wrongturn_open_episodes") == 0


def test_a_batch_shows_the_pictures_of_single_environments(service: LocalService) -> None:
    options: dict[str, Any] = {"town": "junctions", "render_mode": "rgb_array"}
    envs = gymnasium.make_vec("wrongturn_client:Wrongturn-v0", num_envs=2, url=service.url, **options)
    assert envs.metadata["render_modes"] == ["rgb_array"]
    with pytest.raises(ResetNeeded):
        envs.render()
    envs.reset(seed=4)
    envs.step(_gas(2))
    pictures = envs.render()
    envs.close()
    assert pictures is not None
    for i, picture in enumerate(pictures):
        env = RemoteEnv(service.url, **options)
        env.reset(seed=4 + i)
        env.step(GAS)
        np.testing.assert_array_equal(env.render(), picture)
        env.close()
    assert not np.array_equal(*pictures)


def test_stable_baselines_makes_single_environments_and_evaluates_beside_them(service: LocalService) -> None:
    ppo = pytest.importorskip("stable_baselines3").PPO
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.env_util import make_vec_env

    made = {"url": service.url, "town": "junctions", "track": "privileged"}
    envs = make_vec_env("wrongturn_client:Wrongturn-v0", n_envs=2, seed=1, env_kwargs=made)
    callback = EvalCallback(
        make_vec_env("wrongturn_client:Wrongturn-v0", env_kwargs={**made, "max_episode_steps": 4}),
        n_eval_episodes=1,
        eval_freq=4,
    )
    ppo("MultiInputPolicy", envs, n_steps=4, batch_size=8, n_epochs=1, seed=1, device="cpu").learn(8, callback)
    assert np.isfinite(callback.last_mean_reward)
    assert envs.render("rgb_array").shape[2] == 3
    callback.eval_env.close()
    envs.close()


def test_stable_baselines_learns_over_the_wire(service: LocalService) -> None:
    ppo = pytest.importorskip("stable_baselines3").PPO
    from wrongturn_agents.training import WrongturnVecEnv

    envs = WrongturnVecEnv(2, url=service.url, town="junctions", track="privileged", render_mode="rgb_array")
    before = _figure(service.url, "wrongturn_steps_total")
    ppo("MultiInputPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu").learn(64)
    assert _figure(service.url, "wrongturn_steps_total") - before == 64
    envs.seed(3)
    envs.reset()
    assert envs.render().shape == (960, 864, 3)
    told: list[dict[str, Any]] = []
    while not told:
        _, _, dones, infos = envs.step(_gas(2))
        told = [infos[i] for i in np.flatnonzero(dones)]
    assert envs.observation_space.contains(told[0]["terminal_observation"])
    assert {"verdict", "trial", "TimeLimit.truncated"} <= told[0].keys()
    envs.close()
