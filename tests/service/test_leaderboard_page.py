"""The leaderboards' pages, without a browser: what is hidden, what is escaped, what is kept."""

import re
from pathlib import Path

import httpx
from app_harness import application, without_own_script

from wrongturn_judge import compute
from wrongturn_networks import load_suite
from wrongturn_protocol import Outcome, Verdict
from wrongturn_service.storage.models import AgentRow, EvaluationRow, OwnerRow

SUITE = "smoke@3"
PAGE = f"/leaderboards/{SUITE}"
HTML = {"Accept": "text/html"}


async def add(http: httpx.AsyncClient, names: list[str], **agent: object) -> None:
    """Store agents with a finished evaluation each, all of them with the same safe result."""
    suite = load_suite(SUITE)
    ends = {
        trial.id: Outcome(verdict=Verdict.EXIT_COMMANDED, time=1.0, max_deceleration=0.0)
        for trial in suite.open_draw.episodes
    }
    metrics = compute(suite.open_draw, ends).model_dump_json()
    database = http.app.state.service.store._database
    async with database.write() as session:
        for number, name in enumerate(names):
            key = f"{name}-{number}"[:40].lower()
            session.add(OwnerRow(id=f"o{key}"[:40], name=name[:64], name_key=key, created=0.0))
            await session.flush()
            given = {"track": "camera", "kind": "submitted", **agent}
            session.add(
                AgentRow(id=f"a{key}"[:40], name=name, name_key=key, owner_id=f"o{key}"[:40], created=0.0, **given)
            )
            await session.flush()
            session.add(
                EvaluationRow(
                    id=f"e{key}"[:40],
                    agent_id=f"a{key}"[:40],
                    suite=SUITE,
                    suite_sha256=suite.sha256,
                    entry="remote",
                    state="finished",
                    secret=f"{number:064x}",
                    trials=12,
                    created=float(number),
                    finished=float(number),
                    metrics=metrics,
                    seq=number,
                )
            )
    http.app.state.service.leaderboards.forget(SUITE)


async def page(http: httpx.AsyncClient, path: str = PAGE, status: int = 200) -> str:
    reply = await http.get(path, headers=HTML)
    assert reply.status_code == status, reply.text
    assert reply.headers["Content-Type"] == "text/html; charset=utf-8"
    return reply.text


async def test_hostile_names_are_only_text(tmp_path: Path):
    hostile = "<script>alert(1)</script>\"'"
    async with application(tmp_path) as http:
        await add(http, [hostile])
        text = await page(http)
        assert "<script" not in text.replace('<script type="module" src=', "")
        assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;&#34;&#39;") >= 3  # first, row, label or tooltip


async def test_a_page_that_did_not_change_is_not_sent_again(tmp_path: Path):
    async with application(tmp_path) as http:
        first = await http.get(PAGE)
        again = await http.get(PAGE, headers={"If-None-Match": first.headers["ETag"]})
        assert again.status_code == 304
        await add(http, ["newcomer"])
        changed = await http.get(PAGE, headers={"If-None-Match": first.headers["ETag"]})
        assert changed.status_code == 200
        assert "newcomer" in changed.text
        assert (await http.head(PAGE)).headers["ETag"] == changed.headers["ETag"]


async def test_a_large_field_comes_in_pages(tmp_path: Path):
    async with application(tmp_path) as http:
        await add(http, [f"agent {number:03d}" for number in range(230)])
        found: list[str] = []
        for number in (1, 2, 3):
            found += re.findall(r'<a href="../agents/[^"]+">(agent \d+)</a>', await page(http, f"{PAGE}?page={number}"))
        assert found == [f"agent {number:03d}" for number in range(230)]
        assert "from 1 to 3" in await page(http, f"{PAGE}?page=4", 422)
        first, last = await page(http, "/agents?all=true"), await page(http, "/agents?page=3&all=true")
        assert "231 agents by name, page 1 of 3" in first
        assert len(re.findall(r'href="./agents/[^"?]+">', first)) == 100
        assert 'href="./agents?page=2&amp;all=true"' in first
        assert ">one</a>" in last
        for number in ("0", "4", "x", "%C2%B2", "9" * 20):
            assert "from 1 to 3" in await page(http, f"/agents?all=true&page={number}", 422)


async def test_the_page_of_handing_in_says_what_this_service_takes(tmp_path: Path):
    async with application(tmp_path, submissions=0, registration="operator") as http:
        text = await page(http, "/submit")
        assert "turned submissions off" in text
        assert "Only the operator registers owners here" in text
        assert "/v1/submissions" not in text
        reply = await http.get("/submit", headers={"Host": '"><script>alert(1)</script>'})
        assert "<script" not in without_own_script(reply.text)
