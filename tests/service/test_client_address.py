"""Whose a request is: addresses as limits count them, and whose word about them is believed."""

from pathlib import Path
from typing import Any, cast

import httpx
import pytest
from app_harness import application
from service_harness import expect, problem
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp

from wrongturn_service.client_address import address_of, counted
from wrongturn_service.server import configuration
from wrongturn_service.settings import Settings
from wrongturn_service.telemetry import Telemetry

PROXY, INNER = "10.0.0.1", "10.0.0.2"


@pytest.mark.parametrize(
    ("address", "as_counted"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::ffff", "2001:db8:1:2::/64"),
        ("2001:db8:1:3::ffff", "2001:db8:1:3::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::1", "::1"),
        ("testclient", "unknown"),
        ("", "unknown"),
    ],
)
def test_ipv6_counts_by_site(address: str, as_counted: str) -> None:
    assert counted(address) == as_counted


def behind(app: Any, address: str, forwarded: str | None = None, **settings: Any) -> httpx.AsyncClient:
    """A client of an application at an address, before uvicorn's own handling of ``X-Forwarded-For``."""
    config = configuration(app, Settings(**settings))
    config.load()
    transport = httpx.ASGITransport(cast(ASGIApp, config.loaded_app), client=(address, 1))  # type: ignore[arg-type]
    headers = {} if forwarded is None else {"X-Forwarded-For": forwarded}
    return httpx.AsyncClient(transport=transport, base_url="http://test", headers=headers)


@pytest.mark.parametrize(
    ("trusted", "forwarded", "same"),
    [
        # By default nobody is believed.
        ("", ["192.0.2.1", "192.0.2.2"], True),
        (PROXY, ["192.0.2.1", "192.0.2.2"], False),
        # What a client writes into the header does not count, only what the proxy adds.
        (PROXY, ["192.0.2.1, 192.0.2.9", "192.0.2.2, 192.0.2.9"], True),
        (PROXY, ["192.0.2.1, 192.0.2.8", "192.0.2.1, 192.0.2.9"], False),
        # An inner proxy that is not named counts as the client.
        (PROXY, [f"192.0.2.1, {INNER}", f"192.0.2.2, {INNER}"], True),
        (f"{PROXY}, {INNER}", [f"192.0.2.1, {INNER}", f"192.0.2.2, {INNER}"], False),
        ("10.0.0.0/29", [f"192.0.2.1:5000, {INNER}", f"[2001:db8::1]:5000, {INNER}"], False),
        (PROXY, ["2001:db8::1", "2001:db8::2"], True),
        (PROXY, ["nonsense", "other nonsense"], True),
    ],
)
async def test_a_proxy_is_believed_if_it_is_named(trusted: str, forwarded: list[str], same: bool) -> None:
    async def tell(request: Request) -> Response:
        return Response(address_of(request))

    app = Starlette(routes=[Route("/", tell)])
    app.state.telemetry = Telemetry()
    seen = []
    for header in forwarded:
        async with behind(app, PROXY, header, trusted_proxies=trusted) as client:
            seen.append((await client.get("/")).text)
    assert (seen[0] == seen[1]) is same


async def test_an_idempotency_key_belongs_to_its_sender(tmp_path: Path) -> None:
    async with application(tmp_path, operator_token="secret") as http:
        headers = {"Idempotency-Key": "guessed"}
        agent = {"name": "mine", "track": "camera"}
        async with behind(http.app, "192.0.2.1") as mine, behind(http.app, "192.0.2.2") as stranger:  # type: ignore[attr-defined]
            registered = expect(await mine.post("/v1/agents", json=agent, headers=headers), 201)
            again = expect(await mine.post("/v1/agents", json=agent, headers=headers), 201)
            assert again["id"] == registered["id"]
            answer = await stranger.post("/v1/agents", json=agent, headers=headers)
            problem(answer, 409, "agent-name-taken")
            operator = {**headers, "Authorization": "Bearer secret"}
            problem(await mine.post("/v1/agents", json=agent, headers=operator), 409, "agent-name-taken")
            owner = expect(await mine.post("/v1/owners", json={"name": "me"}, headers={"Idempotency-Key": "o"}), 201)
            theirs = await stranger.post("/v1/owners", json={"name": "me"}, headers={"Idempotency-Key": "o"})
            problem(theirs, 409, "owner-name-taken")
            assert owner["token"] not in theirs.text
