"""Many environments over one connection: against the service in memory, which has no socket."""

from typing import Any

import gymnasium
import httpx
import numpy as np
import pytest
from client_fake_service import FakeService, problem
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from wrongturn_client import ApiError, NotFoundError, RemoteVectorEnv, ServiceFullError, ServiceUnreachableError
from wrongturn_protocol import ProblemType

GAS = np.float32([0.1, 0.5, 0.0])
BUSY = problem(ProblemType.SIMULATORS_BUSY, 503, "all 2 simulators are busy", {"retry-after": "1"})


def _make(service: FakeService, number: int = 3, **options: Any) -> RemoteVectorEnv:
    options = {"track": service.track, "token": "t", **options}
    return RemoteVectorEnv(number, "http://fake", transport=service.transport, **options)


def _gas(number: int = 3) -> Any:
    return np.tile(GAS, (number, 1))


def _stepped(service: FakeService) -> list[int]:
    return [len(actions) for actions in service.seen.values()]


def test_those_without_a_token_share_an_agent_for_practice(fake: FakeService) -> None:
    envs = gymnasium.make_vec(
        "wrongturn_client:Wrongturn-v0", 2, url="http://fake", transport=fake.transport, autoreset_mode="SameStep"
    )
    envs.reset()
    envs.close()
    assert sorted(fake.aborted) == ["ep0", "ep1"]
    assert fake.paths("POST").count("/v1/agents") == 1


def test_it_may_be_reset_after_it_was_closed(fake: FakeService) -> None:
    envs = _make(fake)
    for _ in range(2):
        envs.reset()
        envs.step(_gas())
        envs.close()
        with pytest.raises(ResetNeeded):
            envs.step(_gas())
    assert sorted(fake.aborted) == sorted(fake.seen)


@pytest.mark.parametrize(("options", "named"), [({"patience": "long"}, "patience"), ({"patience": -1.0}, "patience")])
def test_what_cannot_be_made_says_why(options: dict[str, Any], named: str, fake: FakeService) -> None:
    with pytest.raises(ValueError, match=named):
        _make(fake, **options)
    assert fake.requests == []


def test_a_reset_that_is_refused_leaves_nothing_open(monkeypatch: pytest.MonkeyPatch, fake: FakeService) -> None:
    monkeypatch.setattr("wrongturn_client.vector_env._BRIEFLY", 0.0)
    envs = _make(fake, suite="smoke@3", trial="one")
    refused = problem(ProblemType.UNKNOWN_TRIAL, 404, "no trial nine")
    fake.inject = lambda request: (
        BUSY if b"eight" in request.content else refused if b"nine" in request.content else None
    )
    with pytest.raises(NotFoundError, match="no trial nine"):
        envs.reset(options={"trial": ["one", "eight", "nine"]})
    fake.inject = None
    assert sorted(fake.aborted) == sorted(fake.seen)
    with pytest.raises(ResetNeeded):
        envs.step(_gas())
    envs.reset()
    envs.step(_gas())


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_step_that_failed_is_taken_again_and_driven_once(mode: AutoresetMode) -> None:
    """Whatever was lost of it: the calls before they were taken, or their answers."""
    service = FakeService(steps=2)
    envs = _make(service, autoreset_mode=mode, patience=0.0)
    envs.reset()
    broken: list[str] = []

    def breaks(request: httpx.Request) -> Exception | None:
        """The second call of each kind, once."""
        kind = f"{request.method} {request.url.path.rsplit('/', 1)[-1]}"
        if kind in broken:
            return None
        broken.append(kind)
        return httpx.ReadError("gone")

    for hook in ("inject", "after"):
        broken.clear()
        setattr(service, hook, breaks)
        with pytest.raises(ServiceUnreachableError):
            envs.step(_gas())
        while True:
            try:
                _, _, terminated, _, _ = envs.step(_gas())
                break
            except ServiceUnreachableError:
                continue
        setattr(service, hook, None)
    assert terminated.all()
    assert _stepped(service)[:3] == [2, 2, 2]


def test_another_error_of_one_loses_nothing_of_the_others(fake: FakeService) -> None:
    envs = _make(fake)
    envs.reset()
    fake.inject = lambda request: (
        problem(ProblemType.INTERNAL, 500) if "ep1" in request.url.path else None  # only this one's
    )
    with pytest.raises(ApiError):
        envs.step(_gas())
    fake.inject = None
    _, rewards, _, _, _ = envs.step(_gas())
    assert rewards.tolist() == [1.5] * 3
    assert _stepped(fake) == [1, 1, 1]


def test_an_episode_that_was_given_up_is_truncated(fake: FakeService) -> None:
    envs = _make(fake)
    first, _ = envs.reset()
    fake.lost.add("ep1")
    seen, rewards, terminated, truncated, infos = envs.step(_gas())
    (i,) = np.flatnonzero(truncated).tolist()
    assert not terminated.any()
    assert [rewards[i], rewards.sum()] == [0.0, 3.0]
    assert np.flatnonzero(infos["_lost"]).tolist() == [i]
    np.testing.assert_array_equal(seen["speed"][i], first["speed"][i])
    _, _, _, truncated, infos = envs.step(_gas())
    assert not truncated.any()
    assert np.flatnonzero(infos["_trial"]).tolist() == [i]


def test_a_service_with_fewer_simulators_is_told_with_the_remedy(fake: FakeService) -> None:
    ready = httpx.Response(200, json={"status": "ok", "simulators": 2})
    fake.inject = lambda request: ready if request.url.path == "/health/ready" else None
    with pytest.raises(ServiceFullError, match=r"num_envs: is 3.* has 2 simulators; make 2 .*WRONGTURN_SIMULATORS=3"):
        _make(fake).reset()
    assert fake.practice == []
    _make(fake, 2).reset()


def _with_room_for_two(service: FakeService) -> None:
    free = iter(range(2))
    service.inject = lambda request: BUSY if request.url.path == "/v1/episodes" and next(free, None) is None else None


def test_a_service_that_stays_too_full_is_told_and_nothing_is_left_open(
    monkeypatch: pytest.MonkeyPatch, fake: FakeService
) -> None:
    monkeypatch.setattr("wrongturn_client.vector_env._BRIEFLY", 0.0)
    _with_room_for_two(fake)
    with pytest.raises(ServiceFullError, match=r"num_envs: is 3.* 2 of 3 episodes .*all 2 simulators"):
        _make(fake, patience=0.0).reset()
    assert sorted(fake.aborted) == sorted(fake.seen)


def test_waits_for_more_and_holds_nothing(monkeypatch: pytest.MonkeyPatch, fake: FakeService) -> None:
    monkeypatch.setattr("wrongturn_client.vector_env._BRIEFLY", 0.0)
    _with_room_for_two(fake)
    held: list[int] = []

    def sleep(seconds: float) -> None:
        held.append(len(fake.seen) - len(fake.aborted))
        fake.inject = None

    monkeypatch.setattr("wrongturn_client.vector_env.time.sleep", sleep)
    envs = _make(fake)
    envs.reset(seed=1)
    assert held == [0]
    assert len(fake.seen) == 5, "who was given up begins as another episode"
    assert {request["seed"] for request in fake.practice[:2]} < {request["seed"] for request in fake.practice[2:]}
    envs.step(_gas())
    assert sorted(_stepped(fake)) == [0, 0, 1, 1, 1]


def test_waits_for_a_service_that_others_have_filled(monkeypatch: pytest.MonkeyPatch, fake: FakeService) -> None:
    monkeypatch.setattr("wrongturn_client.vector_env._BRIEFLY", 0.0)
    pauses: list[float] = []
    busy = problem(ProblemType.SIMULATORS_BUSY, 503, headers={"retry-after": "7"})
    fake.inject = lambda request: busy if request.url.path == "/v1/episodes" else None

    def sleep(seconds: float) -> None:
        pauses.append(seconds)
        fake.inject = None

    monkeypatch.setattr("wrongturn_client.vector_env.time.sleep", sleep)
    _make(fake).reset()
    assert pauses == [7.0]
