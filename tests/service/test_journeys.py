"""A suite of journeys from its first reset to the leaderboard, with simulators that only count."""

from pathlib import Path
from typing import Any

import httpx
import pytest
from app_harness import application, step
from fake_pool import FakePool
from journey_suite import SUITE, journeys, put_among_the_suites
from service_harness import GAS, expect, problem

from wrongturn_protocol import Leaderboard, Metrics, Verdict


@pytest.fixture(autouse=True)
def _suites(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put_among_the_suites(tmp_path / "suites", monkeypatch)


async def evaluated(http: httpx.AsyncClient, steps: int) -> dict[str, Any]:
    """Drive a whole evaluation; gives it as it is told afterwards."""
    begun = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)
    assert begun["trials"] == 6
    while (response := await http.post(f"/v1/evaluations/{begun['id']}/episodes")).status_code == 201:
        for seq in range(1, steps + 1):
            last = expect(await step(http, response.json()["id"], seq), 200)
        assert last["terminated"]
    problem(response, 409, "evaluation-finished")
    return expect(await http.get(f"/v1/evaluations/{begun['id']}"), 200)


async def test_from_the_first_reset_to_the_leaderboard(tmp_path: Path) -> None:
    pool = FakePool()
    late, hit = journeys()[2].id, journeys()[5].id
    pool.ends = {late: Verdict.TIMEOUT, hit: Verdict.COLLISION}
    async with application(tmp_path, pool) as http:
        detail = await evaluated(http, pool.steps)
        assert (detail["state"], detail["finished"]) == ("finished", 6)
        metrics = Metrics.model_validate_json(Metrics.model_validate(detail["metrics"]).model_dump_json())
        assert metrics.navigation is not None
        table = {
            (task.value, condition.value): (count.success, count.episodes)
            for task, cells in metrics.navigation.table.items()
            for condition, count in cells.items()
        }
        assert table == {
            ("straight", "training"): (1, 1),
            ("straight", "new_weather"): (1, 1),
            ("straight", "new_town"): (1, 1),
            ("navigation", "training"): (1, 2),
            ("navigation", "new_town_and_weather"): (0, 1),
        }
        told = await http.get(f"/v1/leaderboards/{SUITE}")
        (entry,) = Leaderboard.model_validate_json(told.text).entries
        assert (entry.rank, entry.eligible, entry.why_not) == (1, True, None)
        assert entry.navigation == metrics.navigation
        assert (entry.twins.trials, entry.excess_unsafe_rate) == (0, None)
        shown = expect(await http.get(f"/v1/evaluations/{detail['id']}/episodes"), 200)["episodes"]
        assert {episode["trial"] for episode in shown} == {trial.id for trial in journeys()}
        assert all(episode["outcome"]["journey"]["wrong_lane"] == 1 for episode in shown)


async def test_the_suite_and_its_trials(tmp_path: Path) -> None:
    async with application(tmp_path) as http:
        suite = expect(await http.get(f"/v1/suites/{SUITE}"), 200)
        assert (suite["trials"], suite["twins"]) == (6, 0)
        trials = expect(await http.get(f"/v1/suites/{SUITE}/trials"), 200)["trials"]
        assert [trial["journey"]["task"] for trial in trials] == [trial.journey.task for trial in journeys()]  # type: ignore[union-attr]
        assert all(trial.get("twin") is None for trial in trials)
        (paper, *_) = expect(await http.get("/v1/suites/smoke@3/trials"), 200)["trials"]
        assert paper["twin"]
        assert "journey" not in paper
        practice = expect(await http.post("/v1/episodes", json={"suite": SUITE, "trial": trials[0]["id"]}), 201)
        assert practice["trial"] == trials[0]["id"]


async def test_a_journey_that_no_simulator_can_end(tmp_path: Path) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        begun = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)["id"]
        while (response := await http.post(f"/v1/evaluations/{begun}/episodes")).status_code == 201:
            expect(await step(http, response.json()["id"], 1), 200)
            pool.deaths_at_abort += [None] * 9
            assert (await http.delete(f"/v1/episodes/{response.json()['id']}")).status_code == 204
        shown = expect(await http.get(f"/v1/evaluations/{begun}/episodes"), 200)["episodes"]
        assert [(one["outcome"]["verdict"], one["outcome"]["reaction"]) for one in shown] == [("aborted", None)] * 6
        metrics = expect(await http.get(f"/v1/evaluations/{begun}"), 200)["metrics"]
        assert metrics["navigation"]["total"]["success"] == 0
        assert metrics["navigation"]["total"]["per_km"] is None


@pytest.mark.parametrize(
    ("body", "trial"),
    [
        ({"town": "Town02", "task": "navigation", "seed": 6}, "Town02.navigation."),
        ({"town": "Town01", "task": "one_turn", "approach": "J3-S", "seed": 1}, "Town01.one_turn.J3-S.s1"),
        ({"town": "Town01", "task": "cruise", "seed": 5, "weather": "WetNoon"}, "Town01.cruise."),
    ],
)
async def test_a_journey_for_practice(tmp_path: Path, body: dict[str, Any], trial: str) -> None:
    async with application(tmp_path) as http:
        first = expect(await http.post("/v1/episodes", json=body), 201)
        assert first["trial"].startswith(trial)
        assert expect(await http.post("/v1/episodes", json=body), 201)["trial"] == first["trial"]
        assert expect(await step(http, first["id"], 1, GAS), 200)["reward"] == 1.0
