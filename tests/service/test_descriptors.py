"""The last file descriptors are not for connections: the service refuses these by name, and goes on."""

import contextlib
from pathlib import Path

import pytest
import structlog
from clocked_service import ClockedService
from raw_socket import connected, http_problem, rest
from service_harness import expect, metrics

from wrongturn_service import server


def test_the_last_ones_are_not_for_connections(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "for_connections", lambda *_: 40)
    service = ClockedService(tmp_path / "wrongturn.db")
    with contextlib.ExitStack() as stack, service.agent() as agent:
        stack.callback(service.close)
        episode = agent.practise()["id"]
        with contextlib.ExitStack() as many:
            clients = [many.enter_context(connected(service)) for _ in range(60)]
            status, headers, told = http_problem(rest(clients[-1]))
            assert (status, told["type"]) == (503, "/problems/service-full")
            assert "40 connections are open, which is the limit" in told["detail"]
            assert int(headers["retry-after"]) >= 1
            expect(agent.step(episode, 1), 200)
        said = [log for log in service.logs if log["event"] == "connection closed"]
        assert [log["reason"] for log in said] == ["too-many"], "one line for all of them"
        figure = 'wrongturn_connections_closed_total{reason="too-many"} '
        (line,) = [line for line in metrics(service.url).splitlines() if line.startswith(figure)]
        assert float(line.removeprefix(figure)) > 1


@pytest.mark.parametrize(("limit", "simulators", "kept"), [(1024, 16, 128), (100, 16, 50), (1 << 20, 16, 128)])
def test_how_many_are_not_for_connections(limit: int, simulators: int, kept: int) -> None:
    assert server.for_connections(limit, simulators) == limit - kept


def test_too_few_are_told_at_the_start() -> None:
    with structlog.testing.capture_logs() as said:
        server.warn_if_few(1 << 20, 16, 4096)
        assert not said
        server.warn_if_few(1024, 16, 4096)
    assert said[0]["connections"] == 896
    assert "to 4224, or set WRONGTURN_MAX_CONNECTIONS to 896" in said[0]["remedy"]
