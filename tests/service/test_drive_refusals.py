"""What the socket refuses, and what becomes of a client that breaks its rules."""

import pytest
from drive_socket import DriveSocket
from service_harness import Agent, RunningService, metrics
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from wrongturn_protocol import Problem, wire

ACTION = (0.0, 0.8, 0.0)


def _refused(service: RunningService, protocols: list[str], **headers: str) -> tuple[int, Problem, dict[str, str]]:
    with pytest.raises(InvalidStatus) as caught:
        connect(
            service.url.replace("http", "ws", 1) + wire.PATH,
            subprotocols=protocols or None,  # type: ignore[arg-type]
            additional_headers=headers,
            proxy=None,
        )
    response = caught.value.response
    assert response.headers["content-type"] == "application/problem+json"
    assert response.body is not None
    return response.status_code, Problem.model_validate_json(response.body), dict(response.headers.raw_items())


@pytest.mark.parametrize("offered", [[], ["wrongturn.drive.v0"], ["chat", "wrongturn.drive.v2"]])
def test_another_version_is_refused_by_name(service: RunningService, agent: Agent, offered: list[str]) -> None:
    status, problem, headers = _refused(service, offered, Authorization=f"Bearer {agent.token}")
    assert (status, problem.type) == (426, "/problems/protocol-version")
    assert wire.SUBPROTOCOL in (problem.detail or "")
    assert (", ".join(offered) or "none") in (problem.detail or "")
    assert headers["sec-websocket-protocol"] == wire.SUBPROTOCOL


@pytest.mark.parametrize("headers", [{}, {"Authorization": "Bearer nobody"}, {"Authorization": "Basic abc"}])
def test_a_handshake_needs_a_token(service: RunningService, headers: dict[str, str]) -> None:
    status, problem, answered = _refused(service, [wire.SUBPROTOCOL], **headers)
    assert (status, problem.type) == (401, "/problems/unauthenticated")
    assert answered["www-authenticate"].startswith("Bearer")


def test_a_revoked_token_ends_the_connection(service: RunningService) -> None:
    with service.agent() as agent, DriveSocket(service, agent.token) as drive:
        assert drive.one("look", "ep_none")[0] == 404
        agent.http.delete(f"/v1/agents/{agent.id}/token")
        drive.send(["look", "ep_none"])
        number, ((status, fields),) = drive.receive()
        assert (number, status, fields["type"]) == (None, 401, "/problems/unauthenticated")


def test_an_id_longer_than_any_is_refused_and_not_repeated(service: RunningService, agent: Agent) -> None:
    long = "x" * 65
    with DriveSocket(service, agent.token) as drive:
        results = drive.call(["look", long], ["abort", long], ["step", long, 1, *ACTION], ["next", long, None])
        for (status, told), field in zip(results, ["episode"] * 3 + ["evaluation"], strict=True):
            assert (status, told["type"]) == (422, "/problems/validation")
            assert told["errors"][0]["path"] == field
            assert long not in str(told)
        assert drive.one("look", long[:64])[0] == 404


def test_calls_are_counted_by_what_they_ask_for(service: RunningService, agent: Agent) -> None:
    with DriveSocket(service, agent.token) as drive:
        drive.one("look", "ep_none")
        drive.one("fly", "ep_none")
    counted = metrics(service.url)
    assert 'method="WS",route="/v1/drive look",status="404"' in counted
    assert 'method="WS",route="/v1/drive unknown",status="422"' in counted
