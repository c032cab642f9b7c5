"""Leaderboards and comparisons over HTTP, from evaluations whose verdicts the test chooses."""

import asyncio
import csv
import io
import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import pytest
from app_harness import application, step
from fake_pool import FakePool
from service_harness import expect, problem

from wrongturn_networks import load_suite
from wrongturn_protocol import AlgorithmResult, Comparison, Leaderboard, SeedOutcome, Track, Verdict
from wrongturn_service.evaluation.algorithms import GROUP

SUITE = "smoke@3"


class TrialsEnd(dict[str, Verdict]):
    """Ends of a pool's episodes: all trials with a fault end alike, twins as they should."""

    def __init__(self, verdict: Verdict) -> None:
        self._verdict = verdict

    def get(self, key: str, default: Any = None) -> Any:
        return default if ".none." in key else self._verdict


async def register(http: httpx.AsyncClient, name: str, track: str = "privileged") -> dict[str, Any]:
    http.headers.pop("Authorization", None)  # without a token, the agent gets an owner of its own
    return expect(await http.post("/v1/agents", json={"name": name, "track": track}), 201)


async def evaluate(http: httpx.AsyncClient, pool: FakePool, agent: dict[str, Any], verdict: Verdict) -> str:
    """Drive an agent through the suite; all its trials end alike."""
    pool.ends, pool.steps = TrialsEnd(verdict), 1
    http.headers["Authorization"] = f"Bearer {agent['token']}"
    evaluation: str = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)["id"]
    for _ in range(12):
        episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        assert expect(await step(http, episode, 1), 200)["terminated"]
    assert expect(await http.get(f"/v1/evaluations/{evaluation}"), 200)["state"] == "finished"
    return evaluation


async def board(http: httpx.AsyncClient, suite: str = SUITE) -> Leaderboard:
    return Leaderboard.model_validate_json((await http.get(f"/v1/leaderboards/{suite}")).text)


async def test_agents_rank_by_counts_of_their_own_draws(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        good, bad = await register(http, "good"), await register(http, "bad")
        await evaluate(http, pool, bad, Verdict.COLLISION)
        await evaluate(http, pool, good, Verdict.EXIT_OTHER)
        found = await board(http)
        assert [(entry.agent.name, entry.rank, entry.unsafe_strict.count) for entry in found.entries] == [
            ("good", 1, 0),
            ("bad", 2, 6),
        ]
        assert all(entry.unsafe_strict.ci83 is not None for entry in found.entries)
        assert {entry.entry for entry in found.entries} == {"remote"}
        assert found.updated is not None
        summaries = expect(await http.get("/v1/leaderboards"), 200)["leaderboards"]
        assert [summary["entries"] for summary in summaries if summary["suite"] == SUITE] == [2]


async def test_a_leaderboard_comes_as_csv(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        url = f"/v1/leaderboards/{SUITE}"
        empty = await http.get(url, headers={"Accept": "text/csv"})
        assert empty.text.startswith("rank,agent,owner,track,kind,")
        assert len(empty.text.splitlines()) == 1
        await evaluate(http, pool, await register(http, "bad"), Verdict.COLLISION)
        await evaluate(http, pool, await register(http, "idle"), Verdict.NOT_ENGAGED)
        answer = await http.get(url, headers={"Accept": "text/csv, */*;q=0.1"})
        assert answer.headers["content-type"] == "text/csv; charset=utf-8"
        assert answer.headers["vary"] == "Accept, Accept-Encoding"
        rows = {row["agent"]: row for row in csv.DictReader(io.StringIO(answer.text))}
        (entry,) = [one for one in (await board(http)).entries if one.agent.name == "bad"]
        told = {
            "rank": "1",
            "owner": "bad",
            "track": "privileged",
            "eligible": "1",
            "why_not": "",
            "trials": "6",
            "unsafe_strict": "6",
            "unsafe_strict_rate": "1.0",
            "ci95_low": str(entry.unsafe_strict.ci95[0]),
            "twins_completed": "6",
            "unsafe_strict_LEFT_RIGHT_omission": "1",
            "evaluation": entry.evaluation,
        }
        assert {name: rows["bad"][name] for name in told} == told
        assert (rows["idle"]["rank"], rows["idle"]["eligible"]) == ("", "0")
        assert "not_engaged" in rows["idle"]["why_not"]
        assert not [name for name in rows["bad"] if name.startswith(("arrived_", "unsafe_strict_CROSS"))]
        for accept in ("*/*", "application/json, text/csv", "text/csv;q=0.5, application/json", "text/csv;q=0"):
            plain = await http.get(url, headers={"Accept": accept})
            assert plain.headers["content-type"] == "application/json"
        problem(await http.get("/v1/leaderboards/no@1", headers={"Accept": "text/csv"}), 404, "unknown-suite")


async def test_two_agents_are_compared_by_id_or_name(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        good, bad = await register(http, "Good"), await register(http, "bad")
        await evaluate(http, pool, good, Verdict.EXIT_OTHER)
        await evaluate(http, pool, bad, Verdict.WRONG_WAY)
        url = f"/v1/leaderboards/{SUITE}/compare"
        found = Comparison.model_validate(expect(await http.get(url, params={"a": good["id"], "b": "BAD"}), 200))
        assert (found.a.name, found.b.name, found.suite) == ("Good", "bad", SUITE)
        assert (found.total_a.unsafe, found.total_b.unsafe, found.difference) == (0, 6, -1.0)
        assert {(one.a.trials, one.b.trials, one.b.unsafe) for one in found.strata} == {(1, 1, 1)}
        # Each of six strata holds one unsafe trial of two; all six have to fall to the same agent: 2 ways of 64.
        assert found.p == pytest.approx(2 / 64)
        turned = Comparison.model_validate(expect(await http.get(url, params={"a": "bad", "b": "good"}), 200))
        assert (turned.difference, turned.p) == (1.0, pytest.approx(found.p))


async def test_a_comparison_that_makes_no_sense_says_what_is_wrong(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        here = await register(http, "here")
        await register(http, "idle")
        await evaluate(http, pool, here, Verdict.EXIT_OTHER)
        url = f"/v1/leaderboards/{SUITE}/compare"
        told = problem(await http.get(url, params={"a": "here", "b": here["id"]}), 422, "validation", "query.b")
        assert "two different" in told["detail"]
        assert told["errors"][0]["message"] == "is 'here', the same agent as a; name two different agents"
        told = problem(await http.get(url, params={"a": "here", "b": "idle"}), 404, "unknown-evaluation", "query.b")
        assert "query.b: 'idle' has no entry on smoke@3" in told["detail"]
        assert told["errors"][0]["message"].startswith("'idle' has no entry")
        told = problem(await http.get(url, params={"a": "nobody", "b": "here"}), 404, "unknown-agent", "query.a")
        assert told["errors"][0]["message"].startswith("there is no agent 'nobody'")
        problem(await http.get(url, params={"b": "here"}), 422, "validation", "query.a")
        problem(await http.get("/v1/leaderboards/no@1/compare", params={"a": "x", "b": "y"}), 404, "unknown-suite")


async def test_algorithms_are_listed_beside_the_agents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = load_suite(SUITE)

    def results(suite_id: str) -> list[AlgorithmResult]:
        if suite_id != SUITE:
            raise RuntimeError("nothing of this suite")
        ends = {trial.id: SeedOutcome(verdict=Verdict.EXIT_COMMANDED) for trial in suite.episodes}
        return [AlgorithmResult(name="ppo", track=Track.PRIVILEGED, suite=SUITE, sha256=suite.sha256, seeds={7: ends})]

    module = ModuleType("made_for_the_board")
    module.results = results  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    point = metadata.EntryPoint("mine", f"{module.__name__}:results", GROUP)
    real = metadata.entry_points
    monkeypatch.setattr(
        metadata, "entry_points", lambda **keys: [point] if keys.get("group") == GROUP else real(**keys)
    )
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        await evaluate(http, pool, await register(http, "me"), Verdict.COLLISION)
        me, ppo = (await board(http)).entries
        assert (me.agent.name, me.rank, me.tied_with) == ("me", 1, ())
        assert (ppo.agent.name, ppo.agent.kind, ppo.rank, ppo.entry) == ("ppo", "algorithm", None, None)
        assert ppo.seeds is not None
        assert ppo.seeds.count == 1
        # A plug-in that fails takes no leaderboard away.
        others = await asyncio.gather(*(board(http, suite) for suite in ("wrong-command@3", "navigation@1")))
        assert [other.entries for other in others] == [(), ()]
