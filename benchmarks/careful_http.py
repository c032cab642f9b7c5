"""How long `careful` takes for a suite over HTTP on this machine, and where the time goes.

    .venv/bin/python benchmarks/careful_http.py [--suite wrong-command@3] [--url URL] [--json FILE]

Starts a service of its own with a fresh SQLite database, unless --url names one. Prints the wall time split into the
agent's own thinking, the calls that step, the calls that reset, and the rest; then the same trials in process, so that
the share of simulation and of transport can be told.
"""

import statistics
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from common import finish, parser
from rich.console import Console
from rich.table import Table

from wrongturn_agents.baselines import Careful
from wrongturn_client import Client, LocalService
from wrongturn_client.http_drive import HttpDrive
from wrongturn_networks import load_suite
from wrongturn_protocol import Track
from wrongturn_protocol.observations import observation_space
from wrongturn_protocol.wire import Call
from wrongturn_sim import Episode


class Stopwatch:
    """Collects how long each call of a function takes, in seconds."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def on(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.times.append(time.perf_counter() - begin)

        return timed

    def row(self, wall: float) -> dict[str, float]:
        ordered = sorted(self.times)
        return {
            "calls": len(ordered),
            "total_s": sum(ordered),
            "share": sum(ordered) / wall,
            "median_ms": 1000 * statistics.median(ordered),
            "p95_ms": 1000 * ordered[int(0.95 * (len(ordered) - 1))],
        }


class TimedCalls(HttpDrive):
    """Drives over HTTP, and times steps and resets apart."""

    def __init__(self, client: Client, parallel: int, steps: Stopwatch, resets: Stopwatch) -> None:
        super().__init__(client, client._transport.patience, parallel)
        self._watches = {Call.STEP.value: steps, Call.NEXT.value: resets}

    def exchange(self, calls: Any) -> Any:
        began = time.perf_counter()
        results = super().exchange(calls)
        self._watches[calls[0][0]].times.append(time.perf_counter() - began)
        return results


def over_http(url: str, suite: str) -> dict[str, Any]:
    acting, stepping, resetting = Stopwatch(), Stopwatch(), Stopwatch()
    agent = Careful()
    agent.act = acting.on(agent.act)  # type: ignore[method-assign]
    with Client(url) as client:
        registered = client.register(f"careful benchmark {time.time_ns() // 1000}", Track.PRIVILEGED)
    with Client(url, registered.token) as client:
        client.connection = lambda parallel: TimedCalls(client, parallel, stepping, resetting)  # type: ignore[method-assign]
        begin = time.perf_counter()
        evaluation = client.evaluate(agent, suite)
        wall = time.perf_counter() - begin
    assert evaluation.metrics is not None
    split = {"agent": acting, "step calls": stepping, "reset calls": resetting}
    return {
        "suite": suite,
        "secret": evaluation.secret,
        "episodes": evaluation.trials,
        "wall_s": wall,
        "unsafe": evaluation.metrics.unsafe.count,
        "twins_completed": evaluation.metrics.twins.completed,
        "split": {name: watch.row(wall) for name, watch in split.items()},
        "rest_s": wall - sum(sum(watch.times) for watch in split.values()),
    }


def in_process(suite: str, secret: str | None, most: int | None) -> dict[str, float]:
    acting, stepping, resetting = Stopwatch(), Stopwatch(), Stopwatch()
    agent = Careful()
    begin = time.perf_counter()
    for trial in load_suite(suite).draw(secret or suite).episodes[:most]:
        agent.reset(observation_space(Track.PRIVILEGED))
        episode = Episode(trial, Track.PRIVILEGED)
        observation = resetting.on(episode.reset)()
        while episode.outcome is None:
            action = acting.on(agent.act)(observation)
            observation = stepping.on(episode.step)(action.steer, action.throttle, action.brake).observation
    return {
        "wall_s": time.perf_counter() - begin,
        "agent_s": sum(acting.times),
        "steps_s": sum(stepping.times),
        "resets_s": sum(resetting.times),
    }


def show(http: dict[str, Any], inside: dict[str, float]) -> None:
    table = Table(title=f"careful on {http['suite']}: {http['episodes']} episodes in {http['wall_s']:.1f} s over HTTP")
    for column in ("", "calls", "total s", "share", "median ms", "p95 ms"):
        table.add_column(column, justify="left" if column == "" else "right")
    for name, row in http["split"].items():
        cells = (f"{row['calls']:.0f}", f"{row['total_s']:.1f}", f"{100 * row['share']:.0f} %")
        table.add_row(name, *cells, f"{row['median_ms']:.2f}", f"{row['p95_ms']:.2f}")
    table.add_row("rest", "", f"{http['rest_s']:.1f}", f"{100 * http['rest_s'] / http['wall_s']:.0f} %", "", "")
    Console().print(table)
    print(f"unsafe {http['unsafe']}, twins completed {http['twins_completed']}")
    print(
        f"The same in process: {inside['wall_s']:.1f} s (agent {inside['agent_s']:.1f}, steps {inside['steps_s']:.1f}, "
        f"resets {inside['resets_s']:.1f}); over HTTP it takes {http['wall_s'] / inside['wall_s']:.1f} times as long."
    )


def main() -> None:
    options_of = parser(__doc__)
    options_of.add_argument("--suite", default="wrong-command@3")
    options_of.add_argument("--url", help="of a service that runs already")
    options = options_of.parse_args()
    suite = "smoke@3" if options.short else options.suite
    with ExitStack() as stack:
        url = options.url
        if url is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            database = f"sqlite+aiosqlite:///{folder}/wrongturn.db"
            url = stack.enter_context(LocalService(database=database)).url
        http = over_http(url, suite)
    inside = in_process(suite, http["secret"], 1 if options.short else None)
    show(http, inside)
    finish({"over_http": http, "in_process": inside}, options)


if __name__ == "__main__":
    main()
