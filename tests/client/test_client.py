"""Calls, their repetition, and what becomes of answers that are none."""

import json
from typing import Any

import httpx
import numpy as np
import pytest
from client_fake_service import FakeService, problem

import wrongturn_client
from wrongturn_client import (
    Action,
    AgentNameTakenError,
    ApiError,
    AuthenticationError,
    Client,
    ConflictError,
    EpisodeLostError,
    InvalidRequestError,
    NotFoundError,
    NoTrialAvailableError,
    ProtocolError,
    ServiceBusyError,
    ServiceFailedError,
    ServiceUnreachableError,
    WrongturnError,
)
from wrongturn_client.errors import api_error
from wrongturn_protocol import PracticeRequest, Problem, ProblemType, Track


def _answering(answer: Any) -> httpx.MockTransport:
    def handle(request: httpx.Request) -> httpx.Response:
        if isinstance(answer, Exception):
            raise answer
        return answer

    return httpx.MockTransport(handle)


def test_token_and_url_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, fake: FakeService) -> None:
    monkeypatch.setenv("WRONGTURN_URL", "http://there:1234/")
    monkeypatch.setenv("WRONGTURN_TOKEN", "secret")
    with Client(transport=fake.transport) as client:
        assert client.url == "http://there:1234"
        client.suites()
    (request,) = fake.requests
    assert str(request.url) == "http://there:1234/v1/suites"
    assert request.headers["authorization"] == "Bearer secret"


def test_without_a_token_none_is_sent(fake: FakeService, client: Client) -> None:
    assert [agent.name for agent in client.agents()] == ["me"]
    assert client.ready()
    assert all("authorization" not in request.headers for request in fake.requests)


@pytest.mark.parametrize("url", ["nowhere", "ftp://a", "http://", "http://[", "127.0.0.1:8000"])
def test_a_url_that_is_none_is_named(url: str) -> None:
    with pytest.raises(WrongturnError, match=r"url: .*give one such as"):
        Client(url)


def test_a_service_at_a_path_keeps_it(fake: FakeService) -> None:
    with Client("http://fake/wrongturn", transport=fake.transport) as client, pytest.raises(NotFoundError):
        client.suites()
    assert fake.requests[0].url.path == "/wrongturn/v1/suites"


def test_names_in_paths_are_quoted(fake: FakeService, client: Client) -> None:
    with pytest.raises(NotFoundError):
        client.suite("../a b?/ä")
    assert fake.requests[0].url.raw_path == b"/v1/suites/..%2Fa%20b%3F%2F%C3%A4"


def test_practice_gives_reward_and_verdict() -> None:
    service = FakeService(track=Track.PRIVILEGED)
    with Client("http://fake", "t", transport=service.transport) as client:
        begin = client.practise(PracticeRequest(town="Town01", approach="J1-S", track=Track.PRIVILEGED))
        assert begin.trial == "t1"
        assert begin.observation["exits"].shape == (3, 60, 2)
        replies = [client.step(begin.id, seq, Action(steer=-0.5, throttle=0, brake=1)) for seq in (1, 2, 3)]
        detail = client.episode(begin.id)
    assert [reply.reward for reply in replies] == [1.5] * 3
    assert [reply.verdict for reply in replies] == [None, None, "exit_route"]
    assert detail.last_reply is not None
    assert np.array_equal(detail.last_reply["observation"]["pose"], replies[-1].observation["pose"])
    assert service.practice == [
        {
            "town": "Town01",
            "approach": "J1-S",
            "fault": "none",
            "weather": "ClearNoon",
            "traffic": {"vehicles": 0, "pedestrians": 0},
            "seed": 0,
            "track": "privileged",
        }
    ]


def test_a_repeated_creation_carries_the_same_key_and_another_creation_another(
    fake: FakeService, client: Client
) -> None:
    broken = [httpx.ReadError("reset")]
    fake.after = lambda request: broken.pop() if broken else None
    client.register("one", Track.PRIVILEGED)
    client.register("two", Track.PRIVILEGED)
    keys = [request.headers["idempotency-key"] for request in fake.requests]
    assert keys[0] == keys[1]
    assert keys[1] != keys[2]


@pytest.mark.parametrize(
    ("name", "track", "rig", "says"),
    [
        ("y", "cam", None, r"^track: is 'cam'; give .*camera.*\. Did you mean camera\?$"),
        ("", "privileged", None, r"^name: is ''; .*letters.*$"),
        ("y", "privileged", {}, r"^rig: the privileged track has none; .*$"),
        ("y", "camera", {"cameras": [{"width": "4", "height": 4}]}, r"^rig\.cameras\.0\.width: .*integer$"),
    ],
)
def test_a_registration_that_is_not_valid_is_told_in_a_line(name: str, track: str, rig: Any, says: str) -> None:
    with Client("http://fake", "") as client, pytest.raises(ValueError, match=says):
        client.register(name, track, rig=rig)


def test_an_owner_registers_and_renews_its_token(fake: FakeService, client: Client) -> None:
    owner = client.register_owner("us", contact="us@example.org")
    assert (owner.name, owner.token) == ("us", "theirs")
    assert json.loads(fake.requests[-1].content) == {"name": "us", "contact": "us@example.org"}
    assert client.owner(owner.id) in client.owners()
    assert client.rotate_owner_token(owner.id).token == "theirs"
    client.revoke_owner_token(owner.id)
    assert fake.paths("DELETE") == ["/v1/owners/o1/token"]


@pytest.mark.parametrize(("told", "simulators"), [({"simulators": 3}, 3), ({}, None), ({"simulators": "many"}, None)])
def test_a_ready_service_tells_its_simulators_or_nothing(
    told: dict[str, Any], simulators: int | None, fake: FakeService, client: Client
) -> None:
    fake.inject = lambda _: httpx.Response(200, json={"status": "ok", **told})
    assert client.simulators() == simulators
    assert fake.paths("GET") == ["/health/ready"]


def test_a_first_contact_is_given_up_soon(monkeypatch: pytest.MonkeyPatch, fake: FakeService) -> None:
    clock = [0.0]
    monkeypatch.setattr("wrongturn_client.transport.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("wrongturn_client.transport.time.sleep", lambda s: clock.__setitem__(0, clock[0] + s))
    with Client("http://fake", transport=fake.transport, patience=60) as client:
        fake.inject = lambda _: httpx.ConnectError("refused")
        with pytest.raises(ServiceUnreachableError):
            client.suites()
        assert 3 < clock[0] <= 5
        fake.inject = None
        client.suites()
        clock[0] = 0.0
        fake.inject = lambda _: httpx.ConnectError("refused")
        with pytest.raises(ServiceUnreachableError):
            client.suites()
        assert 50 < clock[0] <= 60, "a service that has answered before may be starting again"


def test_it_is_told_once_that_a_service_is_waited_for(
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
    fake: FakeService,
) -> None:
    monkeypatch.setattr("wrongturn_client.transport.time.sleep", lambda _: None)
    monkeypatch.setattr("wrongturn_client.transport.time.monotonic", lambda: 0.0)
    caplog.set_level("INFO", logger="wrongturn_client")

    def outage(times: int) -> list[str]:
        """What is logged when so many attempts break."""
        broken = [httpx.ConnectError("refused")] * times
        fake.inject = lambda _: broken.pop() if broken else None
        caplog.clear()
        client.suites()
        return [record.getMessage() for record in caplog.records if record.name == "wrongturn_client"]

    with Client("http://fake", transport=fake.transport, patience=30) as client:
        assert outage(0) == outage(1) == []
        for _ in range(2):
            waits, again = outage(4)
            assert waits == "http://fake does not answer (refused); trying again for up to 30 s"
            assert again == "http://fake answers again"
    assert capsys.readouterr() == ("", "")


def test_retry_after_is_honoured(monkeypatch: pytest.MonkeyPatch, fake: FakeService, client: Client) -> None:
    pauses: list[float] = []
    monkeypatch.setattr("wrongturn_client.transport.time.sleep", pauses.append)
    answers = [problem(ProblemType.SHUTTING_DOWN, 503, headers={"retry-after": s}) for s in ("7", "3")]
    fake.inject = lambda _: answers.pop() if answers else None
    client.suites()
    assert pauses == [3.0, 7.0]


def test_a_longer_pause_than_the_patience_is_not_waited_for(fake: FakeService, client: Client) -> None:
    fake.inject = lambda _: problem(ProblemType.RATE_LIMITED, 429, headers={"retry-after": "3600"})
    with pytest.raises(ServiceBusyError) as caught:
        client.suites()
    assert caught.value.retry_after == 3600
    assert len(fake.requests) == 1


def test_other_problems_are_not_repeated() -> None:
    for status in (400, 401, 404, 405, 409, 410, 413, 422, 500):
        service = FakeService()
        service.inject = lambda _, status=status: problem(ProblemType.INTERNAL, status)  # type: ignore[misc]
        with Client("http://fake", transport=service.transport) as client, pytest.raises(ApiError) as caught:
            client.suites()
        assert caught.value.status == status
        assert len(service.requests) == 1


def test_a_problem_shows_its_fields() -> None:
    body = {
        "type": "/problems/validation",
        "title": "Validation",
        "status": 422,
        "detail": "The body is wrong.",
        "errors": [{"path": "action.steer", "message": "must be finite"}],
    }
    answer = httpx.Response(422, content=json.dumps(body))
    with Client("http://fake", transport=_answering(answer)) as client, pytest.raises(InvalidRequestError) as caught:
        client.suites()
    assert str(caught.value) == "The body is wrong. (action.steer: must be finite)"
    assert caught.value.type == ProblemType.VALIDATION
    assert caught.value.problem.errors[0].path == "action.steer"


ERRORS = {
    ProblemType.UNAUTHENTICATED: (401, AuthenticationError),
    ProblemType.FORBIDDEN: (403, AuthenticationError),
    ProblemType.REGISTRATION_CLOSED: (403, AuthenticationError),
    ProblemType.UNKNOWN_SUITE: (404, NotFoundError),
    ProblemType.AGENT_NAME_TAKEN: (409, AgentNameTakenError),
    ProblemType.NO_TRIAL_AVAILABLE: (409, NoTrialAvailableError),
    ProblemType.SEQUENCE_GAP: (409, ConflictError),
    ProblemType.EPISODE_LOST: (410, EpisodeLostError),
    ProblemType.FAULT_NOT_APPLICABLE: (422, InvalidRequestError),
    ProblemType.RATE_LIMITED: (429, ServiceBusyError),
    ProblemType.INTERNAL: (500, ServiceFailedError),
    ProblemType.SIMULATORS_BUSY: (503, ServiceBusyError),
}


@pytest.mark.parametrize("kind", ERRORS)
def test_each_problem_is_an_error_of_its_family(kind: ProblemType) -> None:
    status, expected = ERRORS[kind]
    error = api_error(Problem(type=f"/problems/{kind}", title="t", status=status, detail="d"), 4.0)
    assert type(error) is expected
    assert error.type == kind
    assert error.retry_after == 4.0


@pytest.mark.parametrize(
    "answer",
    [
        httpx.Response(200, content=b"<html>", headers={"content-type": "text/html"}),
        httpx.Response(200, json={"suites": [{"id": 3}]}),
        httpx.Response(200, json=[]),
        httpx.Response(301, headers={"location": "http://there"}),
        httpx.Response(200, content=b"\xc1", headers={"content-type": "application/msgpack"}),
    ],
)
def test_an_answer_that_is_none_is_a_protocol_error(answer: httpx.Response) -> None:
    with Client("http://fake", transport=_answering(answer)) as client, pytest.raises(ProtocolError):
        client.suites()


@pytest.mark.parametrize("observation", [{"speed": 1}, None, {"speed": [1, 2], "steering": 0, "command": 1}])
def test_an_observation_that_is_none_is_a_protocol_error(observation: Any) -> None:
    answer = httpx.Response(200, json={"seq": 1, "observation": observation, "terminated": False, "truncated": False})
    with Client("http://fake", transport=_answering(answer)) as client, pytest.raises(ProtocolError):
        client.step("e", 1, Action(steer=0, throttle=0, brake=0))


def test_the_public_names_are_there_and_documented() -> None:
    for name in wrongturn_client.__all__:
        assert getattr(wrongturn_client, name).__doc__
    with pytest.raises(AttributeError, match="nothing"):
        _ = wrongturn_client.nothing  # type: ignore[attr-defined]
