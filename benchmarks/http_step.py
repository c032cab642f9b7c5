"""One step over HTTP against the same handler returning a constant, interleaved in one run.

``python benchmarks/http_step.py [--steps N] [--json FILE]``

The constant handler authenticates, negotiates and parses as the step does, and answers with as many bytes, but asks no
simulator: what the ratio shows is the price of the simulation, its process and the sequence's bookkeeping.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from http.client import HTTPConnection
from pathlib import Path
from typing import Annotated, Any

import msgpack
from fastapi import APIRouter, Depends, Request, Response

from wrongturn_protocol import StepRequest
from wrongturn_service import logs, server
from wrongturn_service.address import bind
from wrongturn_service.api.dependencies import Body, CallerDep, EncodingDep, ServiceDep
from wrongturn_service.api.documents import Route
from wrongturn_service.settings import Settings

CASES = (
    ("state", "application/json"),
    ("privileged", "application/json"),
    ("privileged", "application/msgpack"),
    ("segmentation", "application/json"),
    ("segmentation", "application/msgpack"),
)
ACTION = {"steer": 0.0, "throttle": 0.2, "brake": 0.0}


def serve(database: str) -> None:
    """Run the service with one more route, which does what a step does around the simulation."""
    create_app = server.create_app
    bodies: dict[str, bytes] = {}

    async def remember(request: Request, episode: str) -> Response:
        bodies[episode] = await request.body()
        return Response(status_code=204)

    async def constant(
        service: ServiceDep,
        encoding: EncodingDep,
        caller: CallerDep,
        episode: str,
        wanted: Annotated[StepRequest, Depends(Body(StepRequest, binary=True))],
    ) -> Response:
        return Response(bodies[episode], media_type=encoding)

    def with_constant(settings: Settings) -> Any:
        app = create_app(settings)
        routes = APIRouter(prefix="/constant", route_class=Route)
        routes.post("/{episode}/step")(constant)
        routes.put("/{episode}")(remember)
        app.router.routes[:0] = routes.routes  # as early as the route of a real step
        return app

    server.create_app = with_constant
    settings = Settings(port=0, database=database)
    logs.configure("error")
    server.run(settings, bind(settings.host, settings.port))


class Connection:
    """One kept-alive connection."""

    def __init__(self, url: str) -> None:
        host, _, port = url.removeprefix("http://").partition(":")
        self._http = HTTPConnection(host, int(port))
        self._http.connect()
        self.headers = {"Content-Type": "application/json", "Accept": "application/json"}

    def call(self, method: str, path: str, body: bytes, status: int = 200) -> bytes:
        self._http.request(method, path, body, self.headers)
        response = self._http.getresponse()
        content = response.read()
        if response.status != status:
            raise RuntimeError(f"{method} {path}: {response.status} {content[:300]!r}")
        return content

    def timed(self, path: str, body: bytes) -> tuple[float, bytes]:
        began = time.perf_counter()
        content = self.call("POST", path, body)
        return time.perf_counter() - began, content


def registered(http: Connection, track: str) -> str:
    """The token of a new agent of a track; practice is in the agent's own."""
    body = json.dumps({"name": f"benchmark {track}", "track": track}).encode()
    token: str = json.loads(http.call("POST", "/v1/agents", body, 201))["token"]
    return token


def measure(http: Connection, track: str, media: str, steps: int) -> dict[str, Any]:
    pack, unpack = (json.dumps, json.loads) if media.endswith("json") else (msgpack.packb, msgpack.unpackb)

    def encoded(value: object) -> bytes:
        body = pack(value)
        return body.encode() if isinstance(body, str) else body

    http.headers.update({"Content-Type": media, "Accept": media})
    taken: list[float] = []
    constant: list[float] = []
    size = 0
    while len(taken) < steps:
        wanted = {"town": "Town01", "approach": "J3-S", "seed": len(taken), "track": track}
        episode = unpack(http.call("POST", "/v1/episodes", encoded(wanted), 201))["id"]
        first = http.call("POST", f"/v1/episodes/{episode}/step", encoded({"seq": 1, "action": ACTION}))
        http.call("PUT", f"/constant/{episode}", first, 204)
        size = len(first)
        seq, over = 2, False
        while not over:
            body = encoded({"seq": seq, "action": ACTION})
            seconds, content = http.timed(f"/v1/episodes/{episode}/step", body)
            reply = unpack(content)
            over = reply["terminated"] or reply["truncated"]
            if not over:  # the last one waits for its commit
                taken.append(seconds)
                constant.append(http.timed(f"/constant/{episode}/step", body)[0])
            seq += 1
    return {
        "track": track,
        "encoding": media.removeprefix("application/"),
        "bytes": size,
        "steps": len(taken),
        "step": figures(taken),
        "constant": figures(constant),
        "ratio_of_medians": round(statistics.median(taken) / statistics.median(constant), 2),
    }


def figures(seconds: list[float]) -> dict[str, float]:
    percentiles = statistics.quantiles(seconds, n=100)
    return {"p50_ms": round(percentiles[49] * 1e3, 3), "p99_ms": round(percentiles[98] * 1e3, 3)}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--steps", type=int, default=2000, help="of each case, at least")
    arguments.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    arguments.add_argument("--serve", metavar="URL", help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.serve:
        serve(given.serve)
        return
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--serve", f"sqlite+aiosqlite:///{folder}/wrongturn.db"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as service:
            try:
                assert service.stdout is not None
                url = service.stdout.readline().removeprefix("Wrongturn is ready at ").strip()
                http = Connection(url)
                tokens = {track: registered(http, track) for track, _ in CASES}
                results = []
                for track, media in CASES:
                    http.headers["Authorization"] = f"Bearer {tokens[track]}"
                    results.append(measure(http, track, media, given.steps))
            finally:
                service.terminate()
    for row in results:
        print(
            f"{row['track']:<11}{row['encoding']:<8}{row['bytes']:>6} bytes   "
            f"step p50 {row['step']['p50_ms']:.3f} p99 {row['step']['p99_ms']:.3f} ms   "
            f"constant p50 {row['constant']['p50_ms']:.3f} p99 {row['constant']['p99_ms']:.3f} ms   "
            f"ratio {row['ratio_of_medians']:.2f}",
        )
    if given.json:
        given.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
