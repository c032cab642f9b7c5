"""An evaluation comes to its end, whatever happens on the way."""

import contextlib
import hashlib
import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Any

import httpx
import numpy as np
import pytest
from client_fake_service import FakeService, problem
from gymnasium import spaces

from wrongturn_client import (
    Action,
    Client,
    CommitmentError,
    EvaluationCancelledError,
    EvaluationOpenError,
    Policy,
    PolicyError,
    ResultsMismatchError,
    ServiceBusyError,
    WrongturnError,
)
from wrongturn_client.episode_calls import DriveConnection
from wrongturn_client.errors import api_error
from wrongturn_client.evaluation_driver import EpisodeRecorder
from wrongturn_protocol import EvaluationState, Problem, ProblemType, Track
from wrongturn_protocol.observations import Observation, observation_space


class Driver:
    """Steers by the speed that it sees, so that the actions differ."""

    def __init__(self) -> None:
        self.resets: list[spaces.Space[Any]] = []
        self.observations: list[Observation] = []

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        self.resets.append(observation_space)

    def act(self, observation: Observation) -> Action:
        self.observations.append(observation)
        return Action(steer=float(observation["speed"][0]) / 44, throttle=1, brake=0)


def _client(service: FakeService, **options: Any) -> Client:
    return Client("http://fake", "secret", transport=service.transport, **options)


@pytest.mark.parametrize("track", list(Track))
@pytest.mark.parametrize("binary", [True, False])
def test_drives_all_trials_of_every_track(track: Track, binary: bool) -> None:
    service = FakeService(track=track)
    driver = Driver()
    told: list[tuple[int, int]] = []
    with _client(service, binary=binary) as client:
        detail = client.evaluate(driver, "smoke@3", progress=lambda done, of: told.append((done, of)))
    assert isinstance(driver, Policy)
    assert detail.state is EvaluationState.FINISHED
    assert detail.metrics is not None
    assert detail.secret is not None
    assert detail.commitment == hashlib.sha256(detail.secret.encode()).hexdigest()
    assert told == [(n, 4) for n in range(5)]
    assert driver.resets == [observation_space(track)] * 4
    assert len(driver.observations) == 4 * 3
    for observation in driver.observations:
        assert set(observation) == set(observation_space(track))
        assert all(observation[key].dtype == box.dtype for key, box in observation_space(track).items())


def test_puts_what_it_did(fake: FakeService) -> None:
    with _client(fake) as client:
        client.evaluate(Driver(), "smoke@3", versions={"mine": "7"})
    assert fake.results is not None
    assert fake.results["versions"]["mine"] == "7"
    assert "wrongturn-client" in fake.results["versions"]
    assert len(fake.results["episodes"]) == 4
    for record in fake.results["episodes"]:
        actions = np.array(fake.seen[record["episode"]], dtype="<f4")
        assert actions.shape == (record["steps"], 3)
        assert record["actions_sha256"] == hashlib.sha256(actions.tobytes()).hexdigest()
        assert record["latency_ms"] >= 0


def _each_first_time(*, breaks: Callable[[], httpx.Response | Exception]) -> Callable[[httpx.Request], Any]:
    seen: set[tuple[str, str, bytes]] = set()

    def inject(request: httpx.Request) -> httpx.Response | Exception | None:
        key = (request.method, request.url.path, request.content)
        if key in seen:
            return None
        seen.add(key)
        return breaks()

    return inject


BREAKS = {
    "connect": lambda: httpx.ConnectError("refused"),
    "read": lambda: httpx.ReadError("reset"),
    "502": lambda: httpx.Response(502, content=b"<html>"),
    "503": lambda: problem(ProblemType.SIMULATORS_BUSY, 503, headers={"retry-after": "0"}),
    "429": lambda: problem(ProblemType.RATE_LIMITED, 429, headers={"retry-after": "0"}),
}


@pytest.mark.parametrize("name", BREAKS)
@pytest.mark.parametrize("when", ["inject", "after"])
def test_every_call_survives_a_first_failure(
    name: str, when: str, monkeypatch: pytest.MonkeyPatch, fake: FakeService
) -> None:
    # "after": the call had its effect and only its answer was lost, so the repetition must be recognised.
    monkeypatch.setattr("wrongturn_client.transport._SHORTEST_PAUSE", 0.001)
    setattr(fake, when, _each_first_time(breaks=BREAKS[name]))
    with _client(fake) as client:
        detail = client.evaluate(Driver(), "smoke@3")
    assert detail.state is EvaluationState.FINISHED
    assert [len(actions) for actions in fake.seen.values()] == [3] * 4
    assert fake.aborted == []


def test_a_lost_episode_is_nobodys_fault_and_the_next_is_taken(fake: FakeService) -> None:
    fake.lost.add("ep1")
    with _client(fake) as client:
        detail = client.evaluate(Driver(), "smoke@3")
    assert detail.state is EvaluationState.FINISHED
    assert fake.results is not None
    assert [record["episode"] for record in fake.results["episodes"]] == ["ep0", "ep2", "ep3", "ep4"]


def test_waits_while_no_trial_is_available(fake: FakeService) -> None:
    answers = [problem(ProblemType.NO_TRIAL_AVAILABLE, 409, headers={"retry-after": "0.05"}) for _ in range(3)]
    fake.inject = lambda request: (
        answers.pop() if answers and request.url.path.endswith("/e1/episodes") and request.method == "POST" else None
    )
    begin = time.monotonic()
    with _client(fake) as client:
        assert client.evaluate(Driver(), "smoke@3").state is EvaluationState.FINISHED
    assert answers == []
    assert time.monotonic() - begin >= 0.15


@pytest.mark.parametrize("by_id", [True, False])
def test_goes_on_with_an_open_episode_from_its_last_reply(by_id: bool) -> None:
    service = FakeService(steps=5)

    class Killed(Exception):  # noqa: N818
        pass

    def kill(request: httpx.Request) -> None:
        if request.url.path.endswith("/ep1/step") and len(service.seen["ep1"]) == 2:
            raise Killed

    service.inject = kill
    with _client(service) as client, pytest.raises(Killed):
        client.evaluate(Driver(), "smoke@3")
    service.inject = None
    assert service.open == ["ep1"]
    driver = Driver()
    told: list[tuple[int, int]] = []
    with _client(service) as client:
        # It finds the open one by itself, or by its id.
        named = {"evaluation": "e1"} if by_id else {}
        detail = client.evaluate(driver, "smoke@3", progress=lambda done, of: told.append((done, of)), **named)
    assert detail.state is EvaluationState.FINISHED
    assert [len(actions) for actions in service.seen.values()] == [5] * 4
    assert len(driver.observations) == 3 + 2 * 5
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert service.results is not None
    assert [record["episode"] for record in service.results["episodes"]] == ["ep2", "ep3"], "its first half is unknown"


def test_resuming_a_finished_evaluation_gives_it() -> None:
    service = FakeService(trials=0)
    with _client(service) as client:
        detail = client.evaluate(Driver(), "smoke@3", evaluation="e1")
    assert detail.metrics is not None
    assert service.paths("POST") == []


@pytest.mark.parametrize("told", ["6" * 64, None])
def test_a_service_that_breaks_its_promise_is_told(told: str | None, fake: FakeService) -> None:
    fake.secret = told
    with _client(fake) as client, pytest.raises(CommitmentError, match="do not trust"):
        client.evaluate(Driver(), "smoke@3")


@pytest.mark.parametrize("kind", [tuple, list, np.array, np.float32])
def test_an_action_may_be_an_array_a_tuple_or_a_list(kind: Callable[[list[float]], Any]) -> None:
    class Plain(Driver):
        def act(self, observation: Observation) -> Any:
            action = super().act(observation)
            return kind([action.steer, action.throttle, action.brake])

    driven = []
    for driver in (Driver(), Plain()):
        service = FakeService()
        with _client(service) as client:
            client.evaluate(driver, "smoke@3")
        driven.append([np.float32(actions).tolist() for _, actions in sorted(service.seen.items())])
    assert driven[0] == driven[1]


def test_an_open_evaluation_is_named(fake: FakeService) -> None:
    with _client(fake) as client:
        begun = client.create_evaluation("smoke@3")
        with pytest.raises(EvaluationOpenError) as caught:
            client.create_evaluation("smoke@3")
        assert caught.value.evaluation == begun.id
        assert client.cancel_evaluation(begun.id).state is EvaluationState.FINISHED


def test_resuming_needs_the_same_suite() -> None:
    with _client(FakeService()) as client, pytest.raises(WrongturnError, match="smoke@3, not on other@1"):
        client.evaluate(Driver(), "other@1", evaluation="e1")


class Broken(Driver):
    def act(self, observation: Observation) -> Action:
        if len(self.observations) == 4:
            raise RuntimeError("no idea")
        return super().act(observation)


class Wordy(Driver):
    def act(self, observation: Observation) -> Action:
        return "left"  # type: ignore[return-value]


class NotReady(Driver):
    def reset(self, observation_space: spaces.Space[Any]) -> None:
        raise RuntimeError("no idea")


@pytest.mark.parametrize(("policy", "error"), [(Broken, RuntimeError), (Wordy, PolicyError), (NotReady, RuntimeError)])
def test_a_policy_that_breaks_ends_its_episode_and_shows_why(
    policy: type[Driver], error: type[Exception], fake: FakeService
) -> None:
    with _client(fake) as client, pytest.raises(error):
        client.evaluate(policy(), "smoke@3")
    assert len(fake.aborted) == 1
    assert fake.open == []


def test_a_policy_that_breaks_shows_why_though_the_service_has_gone(
    monkeypatch: pytest.MonkeyPatch, fake: FakeService
) -> None:
    fake.inject = lambda request: httpx.ConnectError("gone") if request.method == "DELETE" else None
    with _client(fake, patience=0) as client, pytest.raises(RuntimeError, match="no idea"):
        client.evaluate(NotReady(), "smoke@3")


def test_ctrl_c_leaves_the_episode_for_later(fake: FakeService) -> None:
    class Interrupted(Driver):
        def act(self, observation: Observation) -> Action:
            raise KeyboardInterrupt

    with _client(fake) as client, pytest.raises(KeyboardInterrupt):
        client.evaluate(Interrupted(), "smoke@3")
    assert fake.aborted == []


def test_a_cancelled_evaluation_and_a_mismatch_are_told(fake: FakeService) -> None:
    fake.inject = lambda request: (
        problem(ProblemType.EVALUATION_CANCELLED, 409) if request.url.path.endswith("/episodes") else None
    )
    with _client(fake) as client, pytest.raises(EvaluationCancelledError):
        client.evaluate(Driver(), "smoke@3")
    fake.inject = lambda request: (
        problem(ProblemType.RESULTS_MISMATCH, 409) if request.url.path.endswith("/results") else None
    )
    with _client(fake) as client, pytest.raises(ResultsMismatchError):
        client.evaluate(Driver(), "smoke@3")


@pytest.mark.parametrize("policy", ["careful", None])
def test_what_is_no_policy_begins_nothing(policy: Any, fake: FakeService) -> None:
    with _client(fake) as client, pytest.raises(TypeError, match=r"^policy: is .*; give an object with reset and act"):
        client.evaluate(policy, "smoke@3")
    assert not fake.requests


# Several episodes at a time


class Together(Driver):
    """Begins an episode only when another one begins too."""

    both = threading.Barrier(2, timeout=60)

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        self.both.wait()


def test_two_at_a_time_drive_all_trials_once() -> None:
    service = FakeService(parallel=2)
    open_at_a_time: list[int] = []
    service.inject = lambda request: open_at_a_time.append(len(service.open))
    told: list[tuple[int, int]] = []
    with _client(service) as client:
        detail = client.evaluate(Together(), "smoke@3", parallel=2, progress=lambda done, of: told.append((done, of)))
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
            client.evaluate(policy, "smoke@3", parallel=2)
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
    made = count()

    class Breaks(Together):
        def __init__(self) -> None:
            super().__init__()
            self.number = next(made)

        def act(self, observation: Observation) -> Action:
            if self.number:
                raise RuntimeError("no idea")
            return super().act(observation)

    service = FakeService(parallel=2, steps=10**6)
    with _client(service) as client, pytest.raises(RuntimeError, match="no idea"):
        client.evaluate(Breaks, "smoke@3", parallel=2)
    assert len(service.aborted) == 1
    assert len(service.open) == 1


@pytest.mark.parametrize("connections", [0, 1])
def test_threads_without_a_connection_leave_the_trials_to_the_others(
    connections: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with _client(FakeService(parallel=2)) as client:
        free = iter([client.connection(1)] * connections)

        def connection(_parallel: int) -> DriveConnection:
            if (found := next(free, None)) is None:
                raise api_error(Problem(type="/problems/rate-limited", title="no", status=429, detail="no"))
            return found

        monkeypatch.setattr(client, "connection", connection)
        with contextlib.nullcontext() if connections else pytest.raises(ServiceBusyError):
            assert client.evaluate(Driver(), "smoke@3", parallel=2).state is EvaluationState.FINISHED


def test_none_at_a_time_is_refused() -> None:
    with _client(FakeService()) as client, pytest.raises(ValueError, match="parallel: is 0; drive 1"):
        client.evaluate(Driver(), "smoke@3", parallel=0)
