"""Longest wait of a well-behaved client while others send hostile requests, and the service's memory.

``python benchmarks/hostile.py [--size 12000000] [--only WORD] [--json FILE] [--short]``

A client in a process of its own drives practice episodes over HTTP, a step every 5 ms. Meanwhile each request of
``tests/service/hostile_requests.py`` is sent, then 20 callers ask for each large public address, and 32 for each list
of a few hundred accounts. At the end eight agents of one address reset practice as often as they are let, and never
step. The attacking process has the lowest priority, since attackers have machines of their own.

*Longest* is the longest wait for a step. *Own* is what would be left of it on a machine with nothing else to do: at
most the wait without the time in which the client, the service or a simulator was ready and had no core, and at most
the time that all their threads computed meanwhile (``schedstat``). *Reset* is the longest wait for a reset, which waits
for the disk too. While all simulators are busy, the client sends its reset again after the time that the reply names.
The exit status is 1 if an answer is not the expected one, if *own* is more than 0.25 s, if a reset beside the idle
agents takes more than 1 s, or if the memory stays more than 10 % above its beginning. ``--short`` sends a few small
ones and judges the answers alone, to see that this still runs.
"""

import contextlib
import http.client
import json
import multiprocessing
import os
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/service"))

import httpx
from common import finish, parser
from hostile_requests import HEAVY, Target, hostile_requests
from service_harness import RunningService, expect

LONGEST_S = 0.25
RESET_S = 1.0
GROWTH = 1.1
PAUSE_S = 0.005
SIMULATORS = 4
CALLERS = 20
LISTING = 32
"""Callers of each list."""
LISTS = ("/agents?all=true", "/v1/owners?limit=500", "/v1/agents?all=true&limit=500")
_ACCOUNTS = 500
"""Agents, each with an owner, that the lists hold."""
_IDLE = 8
"""Agents that reset and never step."""
_THEIRS = {"X-Forwarded-For": "203.0.113.7"}
"""The address of the attacking agents."""
_STEPS = 20
"""Of an episode, so that resets come often."""
_STEP = {"steer": 0.0, "throttle": 0.3, "brake": 0.0}
_PRACTICE = {"town": "Town01", "approach": "J3-S"}


class Wait(NamedTuple):
    """A call of the well-behaved client."""

    reset: bool
    """Whether it was a reset, which waits for the disk too."""
    took: float
    """Seconds."""
    own: float
    """What would be left of them on a machine with nothing else to do."""


def scheduled(processes: Iterable[int]) -> tuple[float, float]:
    """Return how long the threads of processes computed, and how long their main threads had no core, seconds."""
    computed = lacked = 0
    for process in processes:
        for thread in Path(f"/proc/{process}/task").glob("*/schedstat"):
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                ran, waited, _ = map(int, thread.read_text(encoding="ascii").split())
                computed += ran
                lacked += waited if thread.parent.name == str(process) else 0
    return computed / 1e9, lacked / 1e9


def family(service: int) -> list[int]:
    """Return the process ids of a service, its simulators and this client."""
    children = Path(f"/proc/{service}/task").glob("*/children")
    return [service, os.getpid(), *sorted({int(pid) for path in children for pid in path.read_text().split()})]


def drive(url: str, token: str, service: int, orders: "Connection[Any, Any]") -> None:
    """Drive without end; answer each order with the waits for all resets and steps since the last one."""
    parts = urlsplit(url)
    agent = http.client.HTTPConnection(str(parts.hostname), parts.port)
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}

    def call(path: str, body: object) -> tuple[dict[str, Any], tuple[float, float]]:
        computed, lacked = scheduled(processes)
        began = time.perf_counter()
        key = {"Idempotency-Key": uuid.uuid4().hex}
        while True:
            agent.request("POST", path, json.dumps(body), {**headers, **key})
            response = agent.getresponse()
            read = json.loads(response.read())
            if response.status != 503:
                break
            time.sleep(int(response.headers["Retry-After"]))
        took = time.perf_counter() - began
        assert response.status in {200, 201}, read
        after = scheduled(processes)
        return read, (took, min(took - (after[1] - lacked), after[0] - computed))

    waits: list[Wait] = []
    while True:
        processes = family(service)
        episode, took = call("/v1/episodes", _PRACTICE)
        waits.append(Wait(True, *took))
        seq, over = 0, False
        while not over:
            seq += 1
            reply, took = call(f"/v1/episodes/{episode['id']}/step", {"seq": seq, "action": _STEP})
            waits.append(Wait(False, *took))
            over = reply["terminated"] or reply["truncated"]
            time.sleep(PAUSE_S)
            if seq == _STEPS:
                over = True
                agent.request("DELETE", f"/v1/episodes/{episode['id']}", headers=headers)
                agent.getresponse().read()
            if orders.poll():
                if not orders.recv():
                    return
                orders.send(waits)
                waits = []


class Bench:
    """A service, a client that drives, and those who disturb it."""

    def __init__(self, service: RunningService, url: str, token: str) -> None:
        self._service = service
        context = multiprocessing.get_context("spawn")
        self._orders, theirs = context.Pipe()
        self._process = context.Process(target=drive, args=(url, token, service.process.pid, theirs), daemon=True)
        self._process.start()
        self._ask()

    def _ask(self) -> list[Wait]:
        self._orders.send(True)
        waits: list[Wait] = self._orders.recv()
        return waits

    def memory(self) -> int:
        """Return the resident memory of the service's own process, bytes."""
        status = Path(f"/proc/{self._service.process.pid}/status").read_text(encoding="ascii")
        return 1024 * next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))

    def measure(self, name: str, work: Callable[[], object]) -> dict[str, Any]:
        """Do something, and return what it did to the client and the service."""
        self._ask()
        before, began = self.memory(), time.monotonic()
        answer = work()
        while time.monotonic() - began < 1:
            time.sleep(0.05)
        took = time.monotonic() - began
        time.sleep(0.2)
        waits = self._ask()
        steps = [wait for wait in waits if not wait.reset]
        resets = [wait for wait in waits if wait.reset]
        return {
            "name": name,
            "answer": answer,
            "took_s": round(took, 1),
            "calls": len(waits),
            "longest_ms": round(1000 * max((wait.took for wait in steps), default=0)),
            "own_ms": round(1000 * max((wait.own for wait in steps), default=0)),
            "reset_ms": round(1000 * max((wait.took for wait in resets), default=0)),
            "memory_MB": round(self.memory() / 1e6),
            "growth": round(self.memory() / before, 3),
        }

    def close(self) -> None:
        """End the client."""
        self._orders.send(False)
        self._process.join(10)


@contextlib.contextmanager
def running(folder: Path, *, short: bool) -> Iterator[RunningService]:
    """Run a service until the block ends."""
    service = RunningService(
        folder / "wrongturn.db",
        simulators=2 if short else SIMULATORS,
        registration_limit=10_000,
        trusted_proxies="127.0.0.1",
        log_level="error",
    )
    try:
        assert service.ready, service.stderr
        time.sleep(0 if short else 15)  # until it has loaded what draws pictures
        yield service
    finally:
        service.kill()


def finished(url: str, token: str) -> dict[str, str]:
    """Drive the smallest evaluation to its end; return what the addresses need."""
    with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=600) as agent:
        evaluation = expect(agent.post("/v1/evaluations", json={"suite": "wrong-command@3"}), 201)["id"]
        episode = expect(agent.post(f"/v1/evaluations/{evaluation}/episodes"), 201)["id"]
        for seq in range(1, 30):
            reply = expect(agent.post(f"/v1/episodes/{episode}/step", json={"seq": seq, "action": _STEP}), 200)
            if reply["terminated"] or reply["truncated"]:  # a drawn trial may be over as soon as that
                break
        expect(agent.delete(f"/v1/evaluations/{evaluation}"), 200)
    return {"finished": evaluation, "episode": episode}


def started(url: str, token: str, count: int) -> None:
    """Start simulators, which takes seconds for each, by as many episodes of practice at a time."""
    with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=600) as agent:
        begun = [expect(agent.post("/v1/episodes", json=_PRACTICE), 201)["id"] for _ in range(count)]
        for episode in begun:
            agent.delete(f"/v1/episodes/{episode}")


def many(url: str, path: str, callers: int = CALLERS) -> list[int]:
    """Ask for an address by many callers at a time, thrice each; return the statuses that were seen."""
    seen = set()

    def call() -> None:
        with httpx.Client(base_url=url, timeout=120) as caller:
            seen.update(caller.get(path).status_code for _ in range(3))

    threads = [threading.Thread(target=call) for _ in range(callers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(seen)


def registered(url: str, count: int) -> list[str]:
    """Register agents, each with an owner, from the attackers' address; return their tokens."""
    with httpx.Client(base_url=url, headers=_THEIRS, timeout=60) as http:
        bodies = [
            {"name": f"idle {number}", "track": "privileged", "description": "x" * 2000} for number in range(count)
        ]
        return [expect(http.post("/v1/agents", json=body), 201)["token"] for body in bodies]


def idle(url: str, tokens: list[str], seconds: float) -> list[int]:
    """Reset practice by each agent as often as it is let, without a step; return the statuses that were seen."""
    seen, until = set(), time.monotonic() + seconds

    def reset(token: str) -> None:
        begun = []
        with httpx.Client(base_url=url, headers={**_THEIRS, "Authorization": f"Bearer {token}"}, timeout=60) as agent:
            while time.monotonic() < until:
                reply = agent.post("/v1/episodes", json=_PRACTICE)
                seen.add(reply.status_code)
                if reply.is_success:
                    begun.append(reply.json()["id"])
                else:
                    time.sleep(min(int(reply.headers["Retry-After"]), max(0.0, until - time.monotonic())))
            for episode in begun:
                agent.delete(f"/v1/episodes/{episode}")

    threads = [threading.Thread(target=reset, args=(token,)) for token in tokens]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(seen)


def main() -> int:
    """Run the benchmark; return the exit status."""
    asked = parser(__doc__)
    asked.add_argument("--size", type=int, default=12_000_000, help="bytes of each request without an end")
    asked.add_argument("--only", default="", help="a part of the names of those to send")
    options = asked.parse_args()
    rows: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Path(folder), short=options.short) as service,
        contextlib.ExitStack() as stack,
    ):
        agents = [stack.enter_context(service.agent("privileged")) for _ in range(2)]
        first, ids = (finished(service.url, agent.token) for agent in agents)
        started(service.url, agents[0].token, 1 if options.short else SIMULATORS)
        names = {"one": agents[0].id, "other": agents[1].id}
        heavy = HEAVY[:2] if options.short else HEAVY
        for path in heavy:  # what is kept of the first evaluation is no growth
            many(service.url, path.format(**first, **names))
        target = Target(service, agents[0].token, agents[0].evaluate()["id"])
        bench = Bench(service, service.url, agents[1].token)
        stack.callback(bench.close)
        os.nice(19)
        requests = hostile_requests(200_000 if options.short else options.size)
        for hostile in list(requests)[:: 12 if options.short else 1]:
            if options.only in hostile.name:
                row = bench.measure(hostile.name, lambda hostile=hostile: hostile.send(target))
                row["as_expected"] = row["answer"] in hostile.answers
                _show(row, rows)
        for path in heavy:
            name = f"{CALLERS} callers of {path}"
            if options.only in name:
                row = bench.measure(name, lambda path=path: many(service.url, path.format(**ids, **names)))
                row["as_expected"] = row["answer"] == [200]
                _show(row, rows)
        tokens = registered(service.url, 20 if options.short else _ACCOUNTS)[:_IDLE]
        for path in LISTS[:1] if options.short else LISTS:
            name = f"{LISTING} callers of {path}"
            if options.only in name:
                row = bench.measure(name, lambda path=path: many(service.url, path, LISTING))
                row["as_expected"] = row["answer"] == [200]
                _show(row, rows)
        name = f"{_IDLE} agents that reset and never step"
        if options.only in name:
            row = bench.measure(name, lambda: idle(service.url, tokens, 3 if options.short else 30))
            row["as_expected"] = 201 in row["answer"] and {*row["answer"]} <= {201, 429, 503}
            row["resets_in_time"] = row["reset_ms"] <= 1000 * RESET_S
            _show(row, rows)
        time.sleep(3)
        last = bench.memory()
    first = rows[0]["memory_MB"]
    sys.stdout.write(f"memory: {first} MB at the beginning, {last / 1e6:.0f} MB at the end\n")
    finish({"attacks": rows}, options)
    if options.short:
        return 0 if rows and all(row["as_expected"] for row in rows) else 1
    good = all(
        row["as_expected"] and row["own_ms"] <= 1000 * LONGEST_S and row.get("resets_in_time", True) for row in rows
    )
    return 0 if good and last / 1e6 <= GROWTH * first else 1


def _show(row: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    rows.append(row)
    sys.stdout.write(
        f"{row['name']:60} {row['answer']!s:8} {'' if row['as_expected'] else '!':1} {row['took_s']:6.1f} s "
        f"longest {row['longest_ms']:5} ms  own {row['own_ms']:4} ms  reset {row['reset_ms']:5} ms  "
        f"{row['memory_MB']:5} MB\n"
    )
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
