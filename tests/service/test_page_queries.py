"""No page and no public call reads all episodes: PostgreSQL answers each of their queries by an index."""

import asyncio
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from app_harness import application
from postgres_server import PostgresServer
from sqlalchemy import text
from sqlalchemy.ext.asyncio import create_async_engine

BENCHMARKS = str(Path(__file__).parents[2] / "benchmarks")


@pytest.fixture
def _benchmarks() -> Iterator[None]:
    """The benchmark's modules can be imported by their plain names."""
    sys.path.insert(0, BENCHMARKS)
    yield
    sys.path.remove(BENCHMARKS)


@pytest.mark.usefixtures("_benchmarks")
async def test_every_query_has_an_index(postgres: PostgresServer, tmp_path: Path) -> None:
    from page_filling import fill
    from page_plans import Query, plan, recorded, scanned
    from pages import an_episode, paths

    url = await asyncio.to_thread(postgres.new_database)
    filled = await fill(url, "smoke@3", 6)
    assert filled.episodes == 6 * 12
    async with application(tmp_path, database=url) as http:
        del http.headers["Authorization"]
        engine = http.app.state.service.store._database._writing  # type: ignore[attr-defined]
        episode = await an_episode(http, filled.evaluations[0])
        with recorded(engine) as queries:
            for path in paths(filled, episode):
                response = await http.get(path)
                assert response.status_code == 200, f"{path}: {response.text[:300]}"
        with recorded(engine) as again:
            a, b = filled.agents[-2:]  # which no page has compared, so nothing of it is kept
            await http.get(f"/v1/leaderboards/smoke@3/compare?a={a}&b={b}")
        assert again
        assert not [query.about for query in again if "evaluations.suite =" in query.about], "reads all agents"
        assert (await http.get(f"/v1/leaderboards/smoke@3/compare?a=%00&b={b}")).status_code == 422
        about = {query.about: query for query in queries}
        assert any("FROM episodes" in line for line in about)
        assert any("FROM trajectories" in line for line in about)
        observer = create_async_engine(url)
        async with observer.connect() as connection:
            # The tables are small, so PostgreSQL would rather read them whole.
            await connection.execute(text("SET enable_seqscan = off"))
            for line, query in about.items():
                assert not scanned(await plan(connection, query)), line
            without = Query("SELECT id FROM episodes WHERE verdict = $1::VARCHAR", ("collision",))
            assert scanned(await plan(connection, without)) == {"episodes"}
        await observer.dispose()
