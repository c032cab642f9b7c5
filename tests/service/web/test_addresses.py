"""Addresses that are wrong, and pages that a browser has already."""

import re
from itertools import product
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import httpx
import pytest
from app_harness import application
from pydantic import ValidationError
from service_harness import problem

from wrongturn_service.settings import Settings

LINK = re.compile(r'(?:href|src|action)="([^"]+)"')
BROWSERS = ("text/html", "text/*", "application/xhtml+xml, */*;q=0.1", "Text/HTML")


async def test_a_reader_with_a_wrong_address_gets_a_page_with_ways_on_and_a_program_a_problem(tmp_path: Path):
    async with application(tmp_path) as http:
        for path, accept in product(("/agentz", "/episodes/", "//agents.example/", "/agents/a/b/"), BROWSERS):
            reply = await http.get(f"http://test{path}", headers={"Accept": accept})
            assert reply.status_code == 404
            assert "<h1>There is no such page</h1>" in reply.text
            assert "openapi" not in reply.text
            ways = {urlsplit(urljoin(f"http://test{path}", way)).path for way in LINK.findall(reply.text)}
            assert ways >= {"/", "/agents", "/suites", "/towns"}, path
        problem(await http.get("/agentz"), 404, "unknown-route")
        for path in ("/v1/agentz", "/v1/suites/"):
            problem(await http.get(path, headers={"Accept": "text/html"}), 404, "unknown-route")


async def test_a_wrong_value_in_the_address_is_named_in_plain_words(tmp_path: Path):
    wrong = [
        ("/agents?page=x", "page", "give a number from 1 to 1"),
        (f"/agents?page={'1' * 50}", "page", "should have at most 40 characters"),
        ("/?track=sonar", "track", "leave it out to see all"),
        ("/leaderboards/smoke@3?kind=%3Cb%3E", "kind", "exploit"),
        ("/?page=0", "page", "give a number from 1 to 1"),
        (f"/submit?suite={'x' * 99}", "suite", "should have at most 80 characters"),
    ]
    async with application(tmp_path) as http:
        for address, name, said in wrong:
            reply = await http.get(address, headers={"Accept": "text/html"})
            assert reply.status_code == 422
            assert f"<li><code>{name}</code>: " in reply.text
            assert said in reply.text
            assert "query." not in reply.text
            assert "Input should" not in reply.text


async def test_a_slash_at_the_end_leads_to_the_page(tmp_path: Path):
    async with application(tmp_path) as http:
        for path in ("/agents", "/docs", "/towns/Town01", "/leaderboards/smoke@3"):
            reply = await http.get(f"{path}/?page=1&a=%26")
            way = urljoin(f"/lab{path}/", reply.headers["Location"])
            assert (reply.status_code, way) == (308, f"/lab{path}?page=1&a=%26")
            assert (await http.get(way.removeprefix("/lab"))).status_code in {200, 422}
        assert (await http.head("/agents//")).headers["Location"] == "../../agents"
        # No way leads to another host.
        assert (await http.get("http://test//agents/")).status_code == 404


async def test_what_a_browser_has_is_not_sent_again(tmp_path: Path):
    async with application(tmp_path) as http:
        for path in ("/agents", "/static/style.css"):
            await not_sent_again(http, path)


async def not_sent_again(http: httpx.AsyncClient, path: str) -> None:
    tag = (await http.get(path)).headers["ETag"]
    for named in (tag, f"W/{tag}", f'"other", {tag}', f'W/"other",W/{tag}', "*"):
        reply = await http.get(path, headers={"If-None-Match": named})
        assert (reply.status_code, reply.content, reply.headers["ETag"]) == (304, b"", tag), named
    for other in ('"other"', tag.strip('"'), f'W/"other", "{tag[1:-2]}"'):
        assert (await http.get(path, headers={"If-None-Match": other})).status_code == 200, other


@pytest.mark.parametrize("public_url", [None, "https://lab.example/wrongturn/"])
async def test_commands_name_the_public_address(tmp_path: Path, public_url: str | None):
    async with application(tmp_path, public_url=public_url) as http:
        told = (public_url or "http://test").rstrip("/")
        for path in ("/submit", "/docs"):
            assert told in (await http.get(path)).text, path
        servers = (await http.get("/openapi.json")).json().get("servers")
        assert servers == (public_url and [{"url": told}])


@pytest.mark.parametrize("url", ["lab.example/wrongturn", "ftp://lab.example", "https://", "https://lab.example/?a=b"])
def test_a_public_address_that_is_none(url: str):
    with pytest.raises(ValidationError, match=r"public_url[\s\S]*like https://lab.example/wrongturn"):
        Settings(public_url=url)
