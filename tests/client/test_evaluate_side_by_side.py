"""Several episodes of one evaluation at a time, for policies that keep no memory."""

from itertools import count
from typing import Any

import pytest
from client_fake_service import FakeService
from gymnasium import spaces

from wrongturn_client import Action, Client
from wrongturn_client.evaluation_driver import EpisodeRecorder
from wrongturn_protocol import EvaluationState
from wrongturn_protocol.observations import Observation


class Gas:
    """Full throttle; may break at its n-th decision."""

    def __init__(self, breaks_at: int | None = None) -> None:
        self.decisions = count(1)
        self.breaks_at = breaks_at

    def reset(self, observation_space: spaces.Space[Any]) -> None: ...

    def act(self, observation: Observation) -> Action:
        if next(self.decisions) == self.breaks_at:
            raise RuntimeError("no idea")
        return Action(steer=0.0, throttle=1.0, brake=0.0)


def _client(service: FakeService) -> Client:
    return Client("http://fake", "secret", transport=service.transport)


def test_two_at_a_time_drive_all_trials_once() -> None:
    service = FakeService(parallel=2)
    open_at_a_time: list[int] = []
    service.inject = lambda request: open_at_a_time.append(len(service.open))
    told: list[tuple[int, int]] = []
    with _client(service) as client:
        detail = client.evaluate(Gas(), "smoke@2", parallel=2, progress=lambda done, of: told.append((done, of)))
    assert detail.state is EvaluationState.FINISHED
    assert max(open_at_a_time) == 2
    assert told == [(n, 4) for n in range(5)]
    assert service.results is not None
    assert len({record["episode"] for record in service.results["episodes"]}) == 4


class Counts:
    """Throttle by the number of its own decisions, which is wrong where two episodes share it."""

    def __init__(self) -> None:
        self.decisions = 0

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        assert not self.decisions

    def act(self, observation: Observation) -> Action:
        self.decisions += 1
        return Action(steer=0.0, throttle=1 / self.decisions, brake=0.0)


def test_a_class_makes_a_policy_for_each_episode() -> None:
    made: list[Counts] = []

    def make() -> Counts:
        made.append(Counts())
        return made[-1]

    for policy in (make, Counts):
        service = FakeService(parallel=2)
        with _client(service) as client:
            client.evaluate(policy, "smoke@2", parallel=2)
        assert service.results is not None
        records = service.results["episodes"]
        assert len(records) == 4
        # Each episode has the actions of a policy that drove nothing else.
        assert {record["actions_sha256"] for record in records} == {_counted(record["steps"]) for record in records}
    assert len(made) == 4


def _counted(steps: int) -> str:
    recorder = EpisodeRecorder("one")
    alone = Counts()
    for _ in range(steps):
        recorder.add(alone.act({}), 0.0)
    return recorder.record().actions_sha256


def test_where_one_breaks_the_others_episode_stays_for_later() -> None:
    service = FakeService(parallel=2)
    with _client(service) as client, pytest.raises(RuntimeError, match="no idea"):
        client.evaluate(Gas(breaks_at=5), "smoke@2", parallel=2)
    assert len(service.aborted) == 1
    assert len(service.open) == 1


def test_none_at_a_time_is_refused() -> None:
    with _client(FakeService()) as client, pytest.raises(ValueError, match="parallel: is 0; drive 1"):
        client.evaluate(Gas(), "smoke@2", parallel=0)
