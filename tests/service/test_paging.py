"""Lists by pages, over HTTP and in the client."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from app_harness import application, register, step
from clocked_service import ClockedService
from fake_pool import FakePool
from service_harness import expect, problem

from wrongturn_client import Client


async def pages(http: httpx.AsyncClient, path: str, name: str, limit: int, **query: Any) -> list[list[dict[str, Any]]]:
    """Follow a list to its end; return the items of each page."""
    found = []
    query = {**query, "limit": limit}
    while True:
        page = expect(await http.get(path, params=query), 200)
        assert set(page) == {name, "next"}
        found.append(page[name])
        if page["next"] is None:
            return found
        query["cursor"] = page["next"]


async def test_agents_and_owners_by_pages(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        for name in ("b", "Da", "c c", "a"):
            expect(await register(http, name=name, track="privileged"), 201)
        names = ["a", "b", "c c", "Da", "one"]
        for path, name, more in (("/v1/agents", "agents", {"all": True}), ("/v1/owners", "owners", {})):
            for limit in (1, 2, 5, 500):
                found = await pages(http, path, name, limit, **more)
                listed = [item["name"] for page in found for item in page if item["name"] != "Wrongturn"]
                assert listed == names
                assert all(len(page) == limit for page in found[:-1])
                assert found[-1]
        expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)
        assert [agent["name"] for [agent] in await pages(http, "/v1/agents", "agents", 1)] == ["one"]
        shown = (await http.get("/agents")).text
        assert "Show 4 more" in shown
        assert "c c" not in shown
        assert "c c" in (await http.get("/agents?all=true")).text


async def test_episodes_by_pages(tmp_path: Path) -> None:
    async with application(tmp_path, FakePool(slots=9)) as http:
        evaluation = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}), 201)["id"]
        url = f"/v1/evaluations/{evaluation}/episodes"
        driven = [expect(await http.post(url), 201)["id"] for _ in range(5)]
        for seq in range(1, 11):
            expect(await step(http, driven[2], seq), 200)
        for limit in (1, 2, 5, 6):
            found = await pages(http, url, "episodes", limit)
            assert [item["id"] for page in found for item in page] == driven
        still = await pages(http, url, "episodes", 3, state="open")
        assert [item["id"] for page in still for item in page] == [*driven[:2], *driven[3:]]
        problem(await http.get(url, params={"state": "nope"}), 422, "validation", "query.state")


@pytest.mark.parametrize(
    ("query", "path"),
    [
        ({"limit": 0}, "limit"),
        ({"limit": 501}, "limit"),
        ({"limit": "many"}, "limit"),
        ({"cursor": ""}, "cursor"),
        ({"cursor": "x"}, "cursor"),
        ({"cursor": "ä"}, "cursor"),
        ({"cursor": "AAAA"}, "cursor"),
        ({"cursor": "YQ==YQ=="}, "cursor"),
        ({"cursor": "a" * 201}, "cursor"),
    ],
)
def test_pages_that_are_none(service: ClockedService, query: dict[str, Any], path: str) -> None:
    told = problem(httpx.get(f"{service.url}/v1/agents", params=query, timeout=60), 422, "validation")
    assert path in told["errors"][0]["path"]


def test_a_cursor_of_another_list(service: ClockedService) -> None:
    with service.agent() as agent:
        for cursor in ("YWJj", "OTk5OTk5OTk5OTk5OTk5OTk5OTk5OTk5"):
            headers = {"Authorization": f"Bearer {agent.token}"}
            answer = httpx.get(f"{service.url}/v1/submissions", params={"cursor": cursor}, headers=headers, timeout=60)
            assert problem(answer, 422, "validation")["errors"][0]["path"] == "query.cursor"


def test_the_client_follows_the_pages(service: ClockedService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wrongturn_client.rest._PAGE", 2)
    with service.agent(), service.agent(), service.agent(), Client(service.url) as client:
        everybody = client.agents(everybody=True)
        assert len({agent.id for agent in everybody}) == len(everybody) >= 3
        assert client.agents() == ()
        assert len(client.owners()) > len(everybody)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClockedService]:
    service = ClockedService(tmp_path_factory.mktemp("paging") / "wrongturn.db")
    yield service
    service.close()
