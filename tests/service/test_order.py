"""What counts first, while the machine's clock is set back a day again and again: numbers decide, not times."""

import time
from pathlib import Path

import httpx
import pytest
from app_harness import application, step
from fake_pool import FakePool
from service_harness import expect
from test_leaderboards import SUITE, board, evaluate, register
from test_submission_store import agent, evaluation, opened, submission

from wrongturn_protocol import SubmissionState, Verdict

DAY_S = 86400.0


class SetBack:
    """The machine's clock, which jumps back by a day whenever it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._back_s = 0.0
        running = time.time
        monkeypatch.setattr(time, "time", lambda: running() - self._back_s)

    def again(self) -> None:
        self._back_s += DAY_S


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SetBack:
    return SetBack(monkeypatch)


async def test_the_evaluation_that_was_begun_first_counts(database_url: str, tmp_path: Path, clock: SetBack) -> None:
    async def counts(http: httpx.AsyncClient) -> None:
        (entry,) = (await board(http)).entries
        assert (entry.evaluation, entry.unsafe.count) == (first, 0)
        finished = http.app.state.service.finished  # type: ignore[attr-defined]
        assert [row.id for row in await finished.of_agent(known["id"])] == [first, later]
        assert await finished.counting(known["id"]) == {first}

    pool = FakePool()
    async with application(tmp_path, pool, database=database_url) as http:
        known = await register(http, "twice")
        first = await evaluate(http, pool, known, Verdict.EXIT_COMMANDED)
        clock.again()
        later = await evaluate(http, pool, known, Verdict.COLLISION)
        await counts(http)
    clock.again()
    async with application(tmp_path, pool, database=database_url, registration="operator") as http:
        await counts(http)


async def test_episodes_are_listed_in_the_order_of_their_resets(tmp_path: Path, clock: SetBack) -> None:
    pool = FakePool()
    async with application(tmp_path, pool) as http:
        began = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)["id"]
        driven = []
        for _ in range(3):
            driven.append(expect(await http.post(f"/v1/evaluations/{began}/episodes"), 201)["id"])
            expect(await step(http, driven[-1], 1), 200)
            clock.again()
        store = http.app.state.service.store  # type: ignore[attr-defined]
        assert [row.id for row in await store.episodes(began)] == driven
        # The missing ones are aborted in the end, and come after them.
        expect(await http.delete(f"/v1/evaluations/{began}"), 200)
        assert [row.id for row in await store.episodes(began)][:3] == driven
        shown = expect(await http.get(f"/v1/evaluations/{began}/episodes"), 200)["episodes"]
        assert [one["id"] for one in shown][:3] == driven
        assert len(shown) == 12


async def test_owners_are_served_in_turn(sqlite_url: str, clock: SetBack) -> None:
    async with opened(sqlite_url) as (_, submissions):
        for name, owner in (("x", "ow_a"), ("y", "ow_b"), ("z", "ow_a")):
            await submissions.add(submission(name, owner), None, most=9)
            await submissions.make_agent(f"su_{name}", agent(name, owner))
            await submissions.set_state(f"su_{name}", SubmissionState.CHECKED)
            await submissions.begin_evaluation(f"su_{name}", evaluation(f"ev_{name}", f"ag_{name}"))
            clock.again()
        assert await submissions.last_served() == {"ow_a": 3, "at ow_a": 3, "ow_b": 2, "at ow_b": 2}
        assert await submissions.turns() == {"su_x": 1, "su_y": 2, "su_z": 3}
