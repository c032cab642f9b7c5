"""Several episodes of one evaluation at a time, for policies that keep no memory."""

import threading
from typing import Any

import pytest
from client_fake_service import FakeService
from gymnasium import spaces

from wrongturn_client import Action, Client
from wrongturn_protocol import EvaluationState
from wrongturn_protocol.observations import Observation


class Together:
    """Decides for the first time once both threads have asked."""

    def __init__(self) -> None:
        self.barrier = threading.Barrier(2, timeout=20.0)
        self.met = threading.local()
        self.threads: set[int] = set()

    def reset(self, observation_space: spaces.Space[Any]) -> None: ...

    def act(self, observation: Observation) -> Action:
        if not getattr(self.met, "already", False):
            self.barrier.wait()
            self.met.already = True
        self.threads.add(threading.get_ident())
        return Action(steer=0.0, throttle=1.0, brake=0.0)


class OneBreaks(Together):
    """One of the two threads meets an error; the other never ends by itself."""

    def act(self, observation: Observation) -> Action:
        super().act(observation)
        if threading.get_ident() == min(self.threads) and len(self.threads) == 2:
            raise RuntimeError("no idea")
        return Action(steer=0.0, throttle=0.0, brake=1.0)


def _client(service: FakeService) -> Client:
    return Client("http://fake", "secret", transport=service.transport)


def test_two_at_a_time_drive_all_trials_once() -> None:
    service = FakeService(parallel=2)
    policy = Together()
    told: list[tuple[int, int]] = []
    with _client(service) as client:
        detail = client.evaluate(policy, "smoke@1", parallel=2, progress=lambda done, of: told.append((done, of)))
    assert detail.state is EvaluationState.FINISHED
    assert len(policy.threads) == 2
    assert told == [(n, 4) for n in range(5)]
    assert service.results is not None
    assert len({record["episode"] for record in service.results["episodes"]}) == 4


def test_where_one_breaks_the_others_episode_stays_for_later() -> None:
    service = FakeService(parallel=2)
    with _client(service) as client, pytest.raises(RuntimeError, match="no idea"):
        client.evaluate(OneBreaks(), "smoke@1", parallel=2)
    assert len(service.aborted) == 1


def test_none_at_a_time_is_refused() -> None:
    with _client(FakeService()) as client, pytest.raises(ValueError, match="parallel: is 0; drive 1"):
        client.evaluate(Together(), "smoke@1", parallel=0)
