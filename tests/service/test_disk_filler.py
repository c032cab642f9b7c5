"""An address that tries to fill the disk: its quota holds, and others drive on.

``pytest -m soak -s tests/service/test_disk_filler.py`` takes a minute, and prints the figures. Each quota alone is
shown in ``test_quotas.py``.
"""

import contextlib
import sqlite3
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from service_harness import GAS, RunningService, expect

ATTACKER = "127.0.0.2"
MIB = 1 << 20
QUOTA = 3 * MIB
LIMITS: dict[str, Any] = {
    "bytes_per_owner": 2 * MIB,
    "bytes_per_address": QUOTA,
    "accounts_per_address": 100_000,
    "agents_per_owner": 100_000,
    "registration_limit": 1_000_000,
}
"""All that is left to hold the attacker is its quota of bytes."""
TEXT = "x" * 2000
PRACTICE = {"town": "Town01", "approach": "J3-S"}


def _key() -> dict[str, str]:
    return {"Idempotency-Key": uuid.uuid4().hex}


class Filler:
    """Stores whatever it can, from an address of its own, and counts the replies."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._over = threading.Event()
        self.statuses: Counter[tuple[str, int]] = Counter()

    @property
    def refused(self) -> bool:
        """Whether even what is smallest did not fit."""
        return self.statuses["registration", 507] + self.statuses["owner", 507] > 0

    def _send(self, http: httpx.Client, what: str, method: str, path: str, **fields: Any) -> dict[str, Any]:
        response = http.request(method, path, **fields)
        self.statuses[what, response.status_code] += 1
        return response.json() if response.is_success and response.content else {}

    def _register(self, http: httpx.Client) -> None:
        body = {"name": f"a{uuid.uuid4().hex[:20]}", "track": "camera", "description": TEXT}
        self._send(http, "registration", "POST", "/v1/agents", json=body, headers=_key())

    def _register_owner(self, http: httpx.Client) -> None:
        body = {"name": f"o{uuid.uuid4().hex[:20]}", "contact": TEXT[:300]}
        self._send(http, "owner", "POST", "/v1/owners", json=body, headers=_key())

    def _practise(self, http: httpx.Client) -> None:
        begun = self._send(http, "practice", "POST", "/v1/episodes", json=PRACTICE, headers=_key())
        for seq in range(1, 11 if begun else 1):
            self._send(http, "step", "POST", f"/v1/episodes/{begun['id']}/step", json={"seq": seq, "action": GAS})
        if begun:
            self._send(http, "abort", "DELETE", f"/v1/episodes/{begun['id']}")

    def _evaluate(self, http: httpx.Client) -> None:
        begun = self._send(http, "evaluation", "POST", "/v1/evaluations", json={"suite": "smoke@3"}, headers=_key())
        if begun:
            url = f"/v1/evaluations/{begun['id']}"
            self._send(http, "reset", "POST", f"{url}/episodes", headers=_key())
            body = {"episodes": [], "versions": {f"{number}{TEXT[:90]}": TEXT[:200] for number in range(50)}}
            self._send(http, "results", "PUT", f"{url}/results", json=body)
            self._send(http, "deletion", "DELETE", url)

    def _rotate(self, http: httpx.Client) -> None:
        token = self._send(http, "rotation", "POST", f"/v1/agents/{http.params['agent']}/token", headers=_key())
        if token:
            http.headers["Authorization"] = f"Bearer {token['token']}"

    def _client(self) -> httpx.Client:
        transport = httpx.HTTPTransport(local_address=ATTACKER)
        return httpx.Client(base_url=self._url, transport=transport, timeout=60)

    def _registered(self) -> httpx.Client:
        http = self._client()
        body = {"name": f"f{uuid.uuid4().hex[:20]}", "track": "privileged"}
        made = expect(http.post("/v1/agents", json=body), 201)
        http.headers["Authorization"] = f"Bearer {made['token']}"
        http.params = {"agent": made["id"]}
        return http

    def _repeat(self, act: Callable[[httpx.Client], None], http: httpx.Client) -> None:
        with contextlib.closing(http):
            while not self._over.is_set():
                act(http)

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        """Fill the disk in every way at once while the block runs."""
        # All agents are there before anything fills their address's quota.
        ways = [(act, self._registered()) for act in (self._practise, self._practise, self._evaluate, self._rotate)]
        ways += [(act, self._client()) for act in (self._register, self._register_owner)]
        threads = [threading.Thread(target=self._repeat, args=way) for way in ways]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self._over.set()
            for thread in threads:
                thread.join()


def _stored(database: Path) -> int:
    with contextlib.closing(sqlite3.connect(database)) as connection:
        query = "SELECT coalesce(sum(stored_bytes), 0) FROM owners WHERE origin = ?"
        return int(connection.execute(query, (ATTACKER,)).fetchone()[0])


def _size(database: Path) -> int:
    """Return the database's size once all is in its file."""
    with contextlib.closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA wal_checkpoint(PASSIVE)")
    return database.stat().st_size


def _filled(service: RunningService, database: Path, seconds: float) -> None:
    """Let an address fill the disk for so long while somebody else practises. Print the figures, and check them."""
    filler, longest, driven, most = Filler(service.url), 0.0, 0, 0
    before = _size(database)
    with service.agent() as agent, filler.working():
        until = time.monotonic() + seconds
        while time.monotonic() < until or not filler.refused:
            episode = agent.practise()["id"]
            for seq in range(1, 10):
                began = time.monotonic()
                expect(agent.step(episode, seq), 200)
                longest = max(longest, time.monotonic() - began)
            driven += 1
            agent.http.delete(f"/v1/episodes/{episode}")
            most = max(most, _stored(database))
    most = max(most, _stored(database))
    grown = _size(database) - before
    print(
        f"\n{seconds:g} s: stored at most {most / MIB:.2f} MiB, quota {QUOTA / MIB:g} MiB; file grew {grown / MIB:.2f}"
    )
    print(f"others: {driven} episodes, longest step {longest * 1000:.0f} ms; replies {dict(filler.statuses)}")
    assert most <= QUOTA
    assert grown <= 1.5 * QUOTA
    assert driven
    assert not [status for _, status in filler.statuses if status >= 500 and status not in {503, 507}]


@pytest.mark.soak
def test_an_address_cannot_fill_the_disk(tmp_path: Path) -> None:
    database = tmp_path / "wrongturn.db"
    service = RunningService(database, simulators=8, **LIMITS)
    assert service.ready, service.stderr
    try:
        _filled(service, database, 60)
    finally:
        service.kill()
