"""Addresses that are wrong, and pages that a browser has already."""

from pathlib import Path

import httpx
import pytest
from app_harness import application, play
from fake_pool import FakePool
from service_harness import problem

BROWSERS = ("text/html", "text/*", "application/xhtml+xml, */*;q=0.1", "Text/HTML")


@pytest.mark.parametrize("accept", BROWSERS)
def test_a_reader_with_a_wrong_address_gets_a_page_with_ways_on(tmp_path: Path, accept: str):
    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            for path in ("/agentz", "/episodes/", "//agents.example/", "/agents/a/b/"):
                reply = await http.get(f"http://test{path}", headers={"Accept": accept})
                assert reply.status_code == 404
                assert "<h1>There is no such page</h1>" in reply.text
                assert "openapi" not in reply.text
                assert all(f'<a href="{way}">' in reply.text for way in ("/", "/agents", "/suites", "/towns"))

    play(story)


def test_programs_get_problems(tmp_path: Path):
    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            problem(await http.get("/agentz"), 404, "unknown-route")
            for path in ("/v1/agentz", "/v1/suites/"):
                problem(await http.get(path, headers={"Accept": "text/html"}), 404, "unknown-route")

    play(story)


@pytest.mark.parametrize(
    ("address", "name", "said"),
    [
        ("/agents?page=x", "page", "give a number from 1 to 1"),
        (f"/agents?page={'1' * 50}", "page", "should have at most 40 characters"),
        ("/?track=sonar", "track", "leave it out to see all"),
        ("/?page=0", "page", "give a number from 1 to 1"),
        (f"/submit?suite={'x' * 99}", "suite", "should have at most 80 characters"),
    ],
)
def test_a_wrong_value_in_the_address_is_named_in_plain_words(tmp_path: Path, address: str, name: str, said: str):
    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            reply = await http.get(address, headers={"Accept": "text/html"})
            assert reply.status_code == 422
            assert f"<li><code>{name}</code>: " in reply.text
            assert said in reply.text
            assert "query." not in reply.text
            assert "Input should" not in reply.text

    play(story)


def test_a_slash_at_the_end_leads_to_the_page(tmp_path: Path):
    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            for path in ("/agents", "/docs", "/towns/Town01", "/leaderboards/smoke@2"):
                reply = await http.get(f"{path}/?page=1&a=%26")
                assert (reply.status_code, reply.headers["Location"]) == (
                    308,
                    f"{path}?page=1&a=%26",
                )
                assert (await http.get(reply.headers["Location"])).status_code in {200, 422}
            assert (await http.head("/agents//")).headers["Location"] == "/agents"
            # No way leads to another host.
            assert (await http.get("http://test//agents/")).status_code == 404

    play(story)


def test_what_a_browser_has_is_not_sent_again(tmp_path: Path):
    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            for path in ("/agents", "/static/style.css"):
                await not_sent_again(http, path)

    play(story)


async def not_sent_again(http: httpx.AsyncClient, path: str) -> None:
    tag = (await http.get(path)).headers["ETag"]
    for named in (tag, f"W/{tag}", f'"other", {tag}', f'W/"other",W/{tag}', "*"):
        reply = await http.get(path, headers={"If-None-Match": named})
        assert (reply.status_code, reply.content, reply.headers["ETag"]) == (304, b"", tag), named
    for other in ('"other"', tag.strip('"'), f'W/"other", "{tag[1:-2]}"'):
        assert (await http.get(path, headers={"If-None-Match": other})).status_code == 200, other
