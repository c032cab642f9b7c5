"""Pages of agents and of two agents, over stored evaluations that nobody drove."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from app_harness import application, without_own_script
from journey_suite import SUITE as JOURNEYS
from journey_suite import put_among_the_suites
from service_harness import expect
from stored_evaluation import exits, outcome, store_evaluation

from wrongturn_networks import load_suite
from wrongturn_protocol import EvaluationState, FaultKind, Flag, Outcome, Trial, Verdict

SUITE = "smoke@3"
HTML = {"Accept": "text/html"}


def leaves_the_road(trial: Trial) -> Outcome:
    return exits(trial) if trial.fault.kind is not FaultKind.INFEASIBLE else outcome(Verdict.OFF_ROAD)


@asynccontextmanager
async def site(folder: Path, **settings: object) -> AsyncIterator[httpx.AsyncClient]:
    async with application(folder, operator_token="the operator", **settings) as http:
        del http.headers["Authorization"]
        http.headers.update(HTML)
        http.service = http.app.state.service
        yield http


async def new_agent(http: httpx.AsyncClient, name: str, **fields: object) -> str:
    body = {"name": name, "track": "privileged", **fields}
    return expect(await http.post("/v1/agents", json=body), 201)["id"]


async def shown(http: httpx.AsyncClient, path: str, status: int = 200) -> str:
    reply = await http.get(path)
    assert reply.status_code == status, reply.text
    assert reply.headers["content-type"].startswith("text/html")
    return reply.text


async def test_a_page_shows_the_evaluation_that_counts_and_lists_the_others(tmp_path: Path):
    async with site(tmp_path) as http:
        agent = await new_agent(http, "leaver")
        first = await store_evaluation(http.service, agent, load_suite(SUITE), leaves_the_road)
        later = await store_evaluation(http.service, agent, load_suite(SUITE), secret="another")
        page = await shown(http, f"/agents/{agent}")
        assert "3 of 6" in page
        assert page.count("/episodes/") == 6 * 2 + 12  # in the list with twins, and on the maps
        assert page.rindex(later) < page.rindex(first)  # the newest evaluation is listed first
        assert "no, a later one" in page
        assert "This is a later evaluation" not in page
        page = await shown(http, f"/agents/{agent}?evaluation={later}")
        assert "This is a later evaluation, which does not count." in page
        assert "A later evaluation is never ranked." in page
        assert "0 of 6" in page


async def test_what_is_running_stays_hidden(tmp_path: Path):
    async with site(tmp_path) as http:
        agent, other = await new_agent(http, "busy"), await new_agent(http, "done")
        running = await store_evaluation(
            http.service, agent, load_suite(SUITE), leaves_the_road, state=EvaluationState.RUNNING
        )
        await store_evaluation(http.service, other, load_suite(SUITE))
        page = await shown(http, f"/agents/{agent}")
        assert "This agent has finished no evaluation yet." in page
        assert running not in page
        assert "/episodes/" not in page
        await shown(http, f"/agents/{agent}?evaluation={running}", 404)
        assert "nothing yet" in await shown(http, "/agents?all=true")
        await shown(http, f"/leaderboards/{SUITE}/compare?a=busy&b=done", 404)


async def test_words_of_strangers_are_only_words(tmp_path: Path):
    async with site(tmp_path) as http:
        agent = await new_agent(
            http,
            "fine",
            description="<script>alert(1)</script> {{ 7 * 7 }}",
            homepage='https://example.org/"><script>alert(2)</script>',
        )
        await store_evaluation(http.service, agent, load_suite(SUITE))
        page = await shown(http, f"/agents/{agent}")
        assert "<script" not in without_own_script(page)
        assert "&lt;script&gt;alert(1)&lt;/script&gt; {{ 7 * 7 }}" in page
        link = re.search(r'<a href="(https://example.org[^"]*)" rel="([^"]*)"', page)
        assert link is not None
        assert link[2] == "nofollow noopener noreferrer"
        wanted = "%3Cscript%3Ealert(3)%3C/script%3E"
        for path in (f"/agents/{wanted}", f"/agents/{agent}?verdict={wanted}", f"/agents/{agent}?suite={wanted}"):
            reply = await http.get(path)
            assert reply.status_code in {404, 422}
            assert "<script" not in without_own_script(reply.text)
        page = await shown(http, f"/leaderboards/{SUITE}/compare?a=%22%3E{wanted}", status=404)
        assert "<script" not in without_own_script(page)


async def test_an_agent_that_gave_up_has_no_paths_but_every_trial(tmp_path: Path):
    async with site(tmp_path) as http:
        agent = await new_agent(http, "quitter")
        await store_evaluation(
            http.service, agent, load_suite(SUITE), lambda _: outcome(Verdict.ABORTED), trajectories=False
        )
        page = await shown(http, f"/agents/{agent}")
        assert page.count("1 of 1 <span") == 6
        assert "6 of 6" in page
        assert 'class="path" d="M' in page  # the key
        assert "<title>Town" not in page


async def test_trials_that_only_the_strict_column_counts_say_so(tmp_path: Path):
    async with site(tmp_path) as http:
        agent = await new_agent(http, "oncoming")
        await store_evaluation(
            http.service,
            agent,
            load_suite(SUITE),
            lambda trial: exits(trial).model_copy(update={"flags": (Flag.OPPOSED_LANE,)}),
        )
        page = await shown(http, f"/agents/{agent}?verdict=unsafe")
        assert "6 of 6 trials" in page
        assert "unsafe in the strict column only" in page


async def test_results_by_factor_are_shown_where_conditions_vary(tmp_path: Path):
    async with site(tmp_path) as http:
        agent = await new_agent(http, "leaver")
        evaluation = await store_evaluation(
            http.service, agent, load_suite("wrong-command-extended@1"), leaves_the_road
        )
        page = await shown(http, f"/agents/{agent}")
        rows = [" ".join(re.sub("<[^>]*>", " ", row).split()) for row in page.split("<tr>")]
        for row in (
            "infeasible 24/24 100 % [86, 100] % 24/24",
            "late, 5 m 0/6 0 % [0, 39] % 6/6",
            "crossing 0/44 0 % [0, 8] % 44/44",
            "paper 12/24 50 % [31, 69] % 24/24",
            "infeasible, left or right 4/4 100 % [51, 100] % 4/4",
        ):
            assert row in rows
        reply = await http.get(f"/v1/evaluations/{evaluation}", headers={"Accept": "application/json"})
        found = expect(reply, 200)
        assert found["metrics"]["breakdown"]["traffic"]["alone"]["count"] == 18
        assert "How much too late it comes: 5 m." in await shown(http, "/suites/wrong-command-extended@1")
        assert "By fault, town" not in await shown(http, "/leaderboards/wrong-command-extended@1")


async def test_journeys_have_pages_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    put_among_the_suites(tmp_path / "suites", monkeypatch)
    async with site(tmp_path) as http:
        agent, other = await new_agent(http, "traveller"), await new_agent(http, "another")
        for each in (agent, other):
            await store_evaluation(http.service, each, load_suite(JOURNEYS))
        page = await shown(http, f"/agents/{agent}?suite={JOURNEYS}")
        assert page.count("/episodes/") == 6
        assert "town and weather of training" in page
        assert "6 of 6" in page
        page = await shown(http, f"/leaderboards/{JOURNEYS}/compare?a=traveller&b=another")
        assert page.count("/episodes/") == 12
        assert "Both drove the same trials." in page
        assert "no trial here" not in page


async def test_two_agents_are_compared_at_the_same_approaches(tmp_path: Path):
    async with site(tmp_path) as http:
        a, b = await new_agent(http, "leaver"), await new_agent(http, "stayer")
        await store_evaluation(http.service, a, load_suite("wrong-command@3"), leaves_the_road)
        await store_evaluation(http.service, b, load_suite("wrong-command@3"), secret="another")
        path = f"/leaderboards/wrong-command@3/compare?a={a}&b=stayer"
        page = await shown(http, path)
        assert "leaver was unsafe in 30 of 60 trials, stayer in 0 of 60" in page
        rows = re.findall(r'<tr><th scope="row">Town01 ([^<]+)<br>.*?</tr>', page, re.DOTALL)
        assert len(rows) == 60
        assert "no trial here" not in page
        # Ten of the twelve approaches of a type are drawn, so eight at least are in both draws.
        others = [row for row in rows if " and " in row]
        assert 0 < len(others) <= 12
        assert all(len(set(row.split(" and "))) == 2 for row in others)
        different = await shown(http, f"{path}&only=different")
        assert len(re.findall('<tr><th scope="row">Town01', different)) < len(rows)
        page = await shown(http, "/leaderboards/smoke@3/compare")
        assert "A comparison needs two agents with a finished evaluation on smoke@3." in page
