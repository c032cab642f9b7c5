"""One step over HTTP: its latency, and the processor time that the service's own process takes for it.

``python benchmarks/http_step.py [--steps N] [--url URL --pid PID] [--json FILE] [--short]``

Practice episodes are driven one after the other over one kept-alive connection, with bodies made by hand, by real
simulators. Resets, and last steps, which wait for their commit, are left out of the figures of steps.
"""

import json
import statistics
import tempfile
import time
from contextlib import ExitStack
from http.client import HTTPConnection
from typing import Any

import msgpack
from common import finish, parser, processor_s

from wrongturn_client import LocalService

CASES = (
    ("state", "application/json"),
    ("privileged", "application/json"),
    ("privileged", "application/msgpack"),
    ("segmentation", "application/json"),
    ("segmentation", "application/msgpack"),
)
ACTION = {"steer": 0.0, "throttle": 0.2, "brake": 0.0}


class Connection:
    """One kept-alive connection."""

    def __init__(self, url: str) -> None:
        host, _, port = url.removeprefix("http://").partition(":")
        self._http = HTTPConnection(host, int(port))
        self.headers = {"Content-Type": "application/json", "Accept": "application/json"}

    def call(self, path: str, message: object, status: int = 200) -> Any:
        as_json = self.headers["Content-Type"].endswith("json")
        self._http.request("POST", path, json.dumps(message) if as_json else msgpack.packb(message), self.headers)
        response = self._http.getresponse()
        content = response.read()
        assert response.status == status, content[:300]
        return content


def measure(http: Connection, pid: int, track: str, media: str, steps: int) -> dict[str, Any]:
    """Drive at least so many steps of a track. The process ``pid`` is the service's."""
    http.headers.update({"Content-Type": media, "Accept": media})
    unpack = json.loads if media.endswith("json") else msgpack.unpackb
    taken: list[float] = []
    resets: list[float] = []
    processor = 0.0
    while len(taken) < steps:
        wanted = {"town": "Town01", "approach": "J3-S", "seed": len(taken), "track": track}
        began = time.perf_counter()
        path = f"/v1/episodes/{unpack(http.call('/v1/episodes', wanted, 201))['id']}/step"
        resets.append(time.perf_counter() - began)
        before = processor_s(pid)
        for seq in range(1, 1 << 16):
            began = time.perf_counter()
            content = http.call(path, {"seq": seq, "action": ACTION})
            seconds, spent = time.perf_counter() - began, processor_s(pid)
            reply = unpack(content)
            if reply["terminated"] or reply["truncated"]:
                break
            taken.append(seconds)
            processor, before = processor + spent - before, spent
    return {
        "track": track,
        "encoding": media.removeprefix("application/"),
        "bytes": len(content),
        "steps": len(taken),
        "step_ms": percentiles(taken),
        "service_ms": round(1e3 * processor / len(taken), 3),
        "reset_ms": percentiles(resets),
    }


def percentiles(seconds: list[float]) -> dict[str, float]:
    """The median and the 99th percentile, in milliseconds."""
    parts = statistics.quantiles([*seconds, *seconds], n=100)
    return {"p50": round(parts[49] * 1e3, 3), "p99": round(parts[98] * 1e3, 3)}


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--steps", type=int, default=2000, help="of each case, at least")
    options.add_argument("--url", help="of a service that runs already")
    options.add_argument("--pid", type=int, help="the process of that service")
    given = options.parse_args()
    cases, steps = (CASES[:1], 5) if given.short else (CASES, given.steps)
    rows = []
    with ExitStack() as stack:
        url, pid = given.url, given.pid
        if url is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            database, quiet = f"sqlite+aiosqlite:///{folder}/wrongturn.db", {"WRONGTURN_LOG_LEVEL": "error"}
            service = stack.enter_context(LocalService(database=database, environment=quiet))
            url, pid = service.url, service.pid
        http = Connection(url)
        tokens = {}
        for track in {track for track, _ in cases}:
            name = f"benchmark {track} {time.time_ns() // 1000}"
            tokens[track] = json.loads(http.call("/v1/agents", {"name": name, "track": track}, 201))["token"]
        for track, media in cases:
            http.headers["Authorization"] = f"Bearer {tokens[track]}"
            rows.append(measure(http, pid, track, media, steps))
    for row in rows:
        print(
            f"{row['track']:<13}{row['encoding']:<8}{row['bytes']:>6} bytes   step p50 {row['step_ms']['p50']:.3f} "
            f"p99 {row['step_ms']['p99']:.3f} ms, of the service's processor {row['service_ms']:.3f} ms   "
            f"reset p50 {row['reset_ms']['p50']:.1f} ms"
        )
    finish({"cases": rows}, given)


if __name__ == "__main__":
    main()
