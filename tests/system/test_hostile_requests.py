"""Requests that are meant to stop the service are refused by name, and cost it little.

``benchmarks/hostile.py`` sends them to a service as it is installed, and measures how long others wait meanwhile.
"""

import asyncio
import gc
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "service"))

from clocked_service import ClockedService
from hostile_requests import Hostile, Target, hostile_requests
from service_harness import expect

SIZE = 300_000


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    service = ClockedService(tmp_path_factory.mktemp("hostile") / "wrongturn.db")
    try:
        with service.agent() as agent:
            yield Target(service, agent.token, agent.evaluate()["id"])
        assert not [log for log in service.logs if log["log_level"] == "error"]
    finally:
        service.close()


@pytest.mark.parametrize("hostile", hostile_requests(SIZE), ids=lambda hostile: hostile.name.replace(" ", "-"))
def test_it_is_refused_and_the_others_drive_on(target: Target, hostile: Hostile) -> None:
    with target.service.agent() as agent:
        episode = agent.practise()["id"]
        assert hostile.send(target) in hostile.answers
        assert expect(agent.step(episode, 1), 200)["seq"] == 1


def test_what_is_over_leaves_nothing_behind(target: Target) -> None:
    def locks() -> int:
        gc.collect()
        return sum(isinstance(thing, asyncio.Lock) for thing in gc.get_objects())

    with target.service.agent() as agent:

        def begin_and_leave(times: int) -> None:
            for _ in range(times):
                evaluation = agent.evaluate()["id"]
                expect(agent.reset(evaluation), 201)
                expect(agent.http.delete(f"/v1/evaluations/{evaluation}"), 200)
                agent.http.request("PROPFIND", f"/v1/evaluations/{evaluation}")

        begin_and_leave(1)
        before, lines = locks(), agent.http.get("/metrics").text.count("\n")
        begin_and_leave(10)
        for method in ("MKCOL", "LOCK", "REPORT", "SEARCH"):
            agent.http.request(method, f"/nowhere/{method}")
        assert locks() - before < 10
        assert agent.http.get("/metrics").text.count("\n") - lines < 100
