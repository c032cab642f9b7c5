"""More clients than there is room for: nothing leaks, and nobody is kept waiting unanswered.

The short one runs with the others; the long one by ``pytest -m soak -s tests/system/test_overload.py``, which prints
its figures.
"""

import asyncio
import contextlib
import json
import statistics
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "service"))

from service_harness import GAS, RunningService, expect

PRACTICE = {"town": "Town01", "approach": "J3-S", "track": "segmentation"}
GROWTH = 1.1
"""Times the memory that there was before."""


@dataclass(frozen=True)
class Size:
    """How much of it."""

    slots: int
    seconds: float
    action: dict[str, float]


OFF = {"steer": 1.0, "throttle": 1.0, "brake": 0.0}
"""Leaves the road within two seconds, so that each client gets its turn soon."""
SIZES = [
    pytest.param(Size(slots=2, seconds=3.0, action=OFF), id="short"),
    pytest.param(
        Size(slots=16, seconds=120.0, action=GAS), id="full", marks=[pytest.mark.soak, pytest.mark.timeout(1200)]
    ),
]


@contextlib.contextmanager
def _service(folder: Path, size: Size, **settings: object) -> Iterator[RunningService]:
    running = RunningService(
        folder / "wrongturn.db",
        simulators=size.slots,
        registration_limit=100_000,
        max_sockets=10_000,
        max_sockets_per_address=10_000,
        log_level="warning",
        **settings,
    )
    try:
        assert running.ready, running.stderr
        yield running
        assert running.stop() == 0, running.stderr
    finally:
        running.kill() if running.process.poll() is None else None


def _await_warm_up(service: RunningService) -> None:
    """Wait until the service has loaded what draws pictures, which it does once, seconds after its start, and keeps."""
    maps = Path(f"/proc/{service.process.pid}/maps")
    deadline = time.monotonic() + 120
    while "/cv2/" not in maps.read_text(encoding="utf-8"):
        assert time.monotonic() < deadline
        time.sleep(0.5)
    # A picture waits for the end of the warm-up.
    with service.agent("segmentation") as agent:
        # Those who came before have gone; their places in the queue go after a while.
        while (answer := agent.http.post("/v1/episodes", json=PRACTICE)).status_code == 503:
            assert time.monotonic() < deadline, answer.text
            time.sleep(0.5)
        episode = expect(answer, 201)["id"]
        assert agent.http.delete(f"/v1/episodes/{episode}").status_code == 204
        assert agent.http.get(f"/v1/episodes/{episode}/picture.png").status_code == 200


def _resident(service: RunningService) -> int:
    """kB of the service's own process."""
    status = Path(f"/proc/{service.process.pid}/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


def _figures(service: RunningService) -> dict[str, float]:
    lines = httpx.get(service.url + "/metrics", timeout=60).text.splitlines()
    return {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines if line[0] != "#")}


def _report(**figures: object) -> None:
    sys.stdout.write(json.dumps(figures) + "\n")


@dataclass
class Client:
    """One of too many."""

    headers: dict[str, str]
    begun: int = 0
    finished: int = 0
    refused: Counter[int] = field(default_factory=Counter)
    positions: list[int] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)
    strange: list[str] = field(default_factory=list)


async def _crowd(http: httpx.AsyncClient, client: Client, action: dict[str, float], deadline: float) -> None:
    key, since = str(uuid.uuid4()), time.monotonic()
    while time.monotonic() < deadline:
        response = await http.post("/v1/episodes", json=PRACTICE, headers={**client.headers, "Idempotency-Key": key})
        if response.status_code in {429, 503}:
            await asyncio.sleep(_pause(client, response))
            continue
        client.begun += 1
        client.waits.append(time.monotonic() - since)
        if await _drive(http, client, action, expect(response, 201)["id"]):
            client.finished += 1
        key, since = str(uuid.uuid4()), time.monotonic()


async def _drive(http: httpx.AsyncClient, client: Client, action: dict[str, float], episode: str) -> bool:
    seq = 1
    while True:
        body = {"seq": seq, "action": action}
        response = await http.post(
            f"/v1/episodes/{episode}/step", json=body, headers={**client.headers, "Accept": "application/msgpack"}
        )
        if response.status_code in {429, 503}:
            await asyncio.sleep(_pause(client, response))
            continue
        if response.status_code != 200:
            client.strange.append(f"{response.status_code} {response.text[:200]}")
            return False
        if b"verdict" in response.content:
            return True
        seq += 1


def _pause(client: Client, response: httpx.Response) -> float:
    told: dict[str, Any] = response.json()
    client.refused[response.status_code] += 1
    client.positions.append(told["position"])
    return int(response.headers["Retry-After"])


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_ten_times_more_clients_than_slots(tmp_path: Path, size: Size) -> None:
    """All is answered: an episode that comes to its end, or a place and when to come back."""
    clients: list[Client] = []
    memory: list[int] = []

    async def crowd(service: RunningService, seconds: float) -> None:
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=None)
        async with httpx.AsyncClient(base_url=service.url, timeout=600, limits=limits) as http:
            if not clients:
                for number in range(10 * size.slots):
                    body = {"name": f"one of too many {number}", "track": "segmentation"}
                    token = expect(await http.post("/v1/agents", json=body), 201)["token"]
                    clients.append(Client({"Authorization": f"Bearer {token}"}))
            deadline = time.monotonic() + seconds
            await asyncio.gather(*(_crowd(http, client, size.action, deadline) for client in clients))

    with _service(tmp_path, size) as service:
        # What each process and connection takes once is there after a while.
        asyncio.run(crowd(service, size.seconds / 4))
        _await_warm_up(service)
        for _ in range(2):
            memory.append(_resident(service))
            asyncio.run(crowd(service, size.seconds / 2))
        memory.append(_resident(service))
        figures = _figures(service)
    refused = sum((client.refused for client in clients), Counter())
    assert not [strange for client in clients for strange in client.strange]
    assert sum(client.begun for client in clients) == sum(client.finished for client in clients) > 0
    assert refused.keys() <= {429, 503}
    assert sum(refused.values()) > 0
    # A place whose client went away with an earlier crowd is kept for a while.
    assert all(1 <= position <= len(memory) * len(clients) for client in clients for position in client.positions)
    assert figures["wrongturn_open_episodes"] == figures["wrongturn_simulators_busy"] == 0
    each = [client.finished for client in clients]
    waits = sorted(wait for client in clients for wait in client.waits)
    _report(
        slots=size.slots,
        clients=len(clients),
        seconds=size.seconds,
        finished=sum(each),
        each={"least": min(each), "median": statistics.median(each), "most": max(each)},
        refused=dict(refused),
        wait_s={"median": round(statistics.median(waits), 2), "longest": round(waits[-1], 2)},
        kB=memory,
    )
    assert memory[-1] < GROWTH * memory[0]
