"""More clients than there is room for: nothing leaks, and nobody is kept waiting unanswered.

It takes minutes: ``pytest -m soak -s tests/system/test_overload.py`` runs it and prints its figures. That each call has
its place in the queue, and comes to its turn, is shown by ``tests/service/test_limits.py``.
"""

import asyncio
import json
import statistics
import sys
import time
import uuid
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "service"))

from service_harness import GAS, RunningService, expect

PRACTICE = {"town": "Town01", "approach": "J3-S", "track": "segmentation"}
SLOTS = 16
SECONDS = 120.0
GROWTH = 1.1
"""Times the memory that there was before."""


def _resident(service: RunningService) -> int:
    """kB of the service's own process."""
    status = Path(f"/proc/{service.process.pid}/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


def _figures(service: RunningService) -> dict[str, float]:
    lines = httpx.get(service.url + "/metrics", timeout=60).text.splitlines()
    return {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines if line[0] != "#")}


@dataclass
class Client:
    """One of too many."""

    headers: dict[str, str]
    finished: int = 0
    refused: Counter[int] = field(default_factory=Counter)
    positions: list[int] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)

    async def call(self, http: httpx.AsyncClient, path: str, body: object, **headers: str) -> httpx.Response:
        """Call again until it is this client's turn."""
        while True:
            response = await http.post(path, json=body, headers={**self.headers, **headers})
            if response.status_code not in {429, 503}:
                return response
            self.refused[response.status_code] += 1
            self.positions.append(response.json()["position"])
            await asyncio.sleep(int(response.headers["Retry-After"]))

    async def drive(self, http: httpx.AsyncClient, deadline: float) -> None:
        """Drive one episode after the other."""
        while time.monotonic() < deadline:
            since = time.monotonic()
            begun = await self.call(http, "/v1/episodes", PRACTICE, **{"Idempotency-Key": str(uuid.uuid4())})
            self.waits.append(time.monotonic() - since)
            step, seq, over = f"/v1/episodes/{expect(begun, 201)['id']}/step", 0, False
            while not over:
                seq += 1
                response = await self.call(http, step, {"seq": seq, "action": GAS}, Accept="application/msgpack")
                assert response.status_code == 200, response.text[:200]
                over = b"verdict" in response.content
            self.finished += 1


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_ten_times_more_clients_than_slots(tmp_path: Path) -> None:
    """All is answered: an episode that comes to its end, or a place and when to come back."""
    service = RunningService(
        tmp_path / "wrongturn.db", simulators=SLOTS, registration_limit=100_000, log_level="warning"
    )
    clients: list[Client] = []
    memory: list[int] = []

    async def crowd(seconds: float) -> None:
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=None)
        async with httpx.AsyncClient(base_url=service.url, timeout=600, limits=limits) as http:
            while len(clients) < 10 * SLOTS:
                body = {"name": f"one of too many {len(clients)}", "track": "segmentation"}
                token = expect(await http.post("/v1/agents", json=body), 201)["token"]
                clients.append(Client({"Authorization": f"Bearer {token}"}))
            deadline = time.monotonic() + seconds
            await asyncio.gather(*(client.drive(http, deadline) for client in clients))

    try:
        assert service.ready, service.stderr
        # What each process and connection takes once, and the warm-up for pictures, is there after a while.
        asyncio.run(crowd(SECONDS / 2))
        for _ in range(2):
            memory.append(_resident(service))
            asyncio.run(crowd(SECONDS / 2))
        memory.append(_resident(service))
        figures = _figures(service)
        assert service.stop() == 0, service.stderr
    finally:
        service.kill()
    refused = sum((client.refused for client in clients), Counter())
    assert sum(refused.values()) > 0
    # A place whose client went away with an earlier crowd is kept for a while.
    assert all(1 <= position <= len(memory) * len(clients) for client in clients for position in client.positions)
    assert figures["wrongturn_open_episodes"] == figures["wrongturn_simulators_busy"] == 0
    each = [client.finished for client in clients]
    waits = sorted(wait for client in clients for wait in client.waits)
    told = {"least": min(each), "median": statistics.median(each), "most": max(each)}
    wait_s = {"median": round(statistics.median(waits), 2), "longest": round(waits[-1], 2)}
    sys.stdout.write(json.dumps({"each": told, "refused": refused, "wait_s": wait_s, "kB": memory}) + "\n")
    assert memory[-1] < GROWTH * memory[0]
