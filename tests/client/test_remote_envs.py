"""The environments over the wire of a real service: what breaks, and who goes on."""

import pickle
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from client_forwarder import Forwarder, figure

from wrongturn_client import LocalService, RemoteEnv, RemoteVectorEnv, WrongturnError

GAS = np.float32([0.1, 0.8, 0.0])


def _gas(number: int) -> Any:
    return np.tile(GAS, (number, 1))


@pytest.fixture
def forwarder(service: LocalService) -> Iterator[Forwarder]:
    forwarder = Forwarder(service.url)
    yield forwarder
    forwarder.close()


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


def test_stable_baselines_learns_over_the_wire(service: LocalService) -> None:
    ppo = pytest.importorskip("stable_baselines3").PPO
    from wrongturn_agents.training import WrongturnVecEnv

    envs = WrongturnVecEnv(2, url=service.url, town="junctions", track="privileged", render_mode="rgb_array")
    before = figure(service.url, "wrongturn_steps_total")
    ppo("MultiInputPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu").learn(64)
    assert figure(service.url, "wrongturn_steps_total") - before == 64
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
