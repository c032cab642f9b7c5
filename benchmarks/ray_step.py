"""Simulators on Ray beside those of this machine: the same bytes, and what a step takes.

``python benchmarks/ray_step.py [--episodes N] [--json FILE] [--short]``

Each episode is driven in a local simulator and in one on a Ray cluster of three nodes on this machine, a step here and
a step there, with pictures, and mostly with traffic. Observations, outcomes, trajectories and hashes have to be the
same bytes. Beside the times of a step are those of bare sockets that carry messages of the same sizes between two
processes: a socket pair, as local simulators have, and TCP, as those on Ray.
"""

import math
import os
import socket
import statistics
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import uvloop
from common import finish, parser
from ray_nodes import Nodes

from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import FaultKind, Track, Traffic, Trial, Weather
from wrongturn_ray.programs import Programs
from wrongturn_ray.settings import RaySettings
from wrongturn_ray.simulators import RayStarter
from wrongturn_service.encoding import Encoding
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.interface import StepResult, rounded
from wrongturn_service.simulators.local_simulator import LocalStarter
from wrongturn_service.simulators.simulator import Simulator

TRACK = Track.SEGMENTATION
_REQUEST = 46
"""Bytes of a step's request."""
_BARE = 2000


def trials(count: int) -> list[Trial]:
    """Trials in two towns, in all weathers; three of four have other cars and pedestrians."""
    towns = [load_town(name) for name in ("Town01", "Town02")]
    weathers = list(Weather)
    made = []
    for number in range(count):
        town = towns[number % len(towns)]
        approaches = sorted(town.approaches)
        traffic = Traffic(vehicles=12, pedestrians=12) if number % 4 else Traffic()
        weather = weathers[number // 2 % len(weathers)]
        approach = approaches[number * 7 % len(approaches)]
        made.append(draw_trial(town, approach, FaultKind.NONE, number, weather=weather, traffic=traffic))
    return made


def action(step: int, episode: int) -> tuple[float, float, float]:
    """What is driven: anything, as long as it is the same on both sides."""
    return rounded(0.03 * math.sin(0.2 * step + episode), 0.4 if step < 40 else 0.15, 0.0)


async def compare(number: int, trial: Trial, sides: dict[str, Simulator], taken: dict[str, list[float]]) -> int:
    """Drive an episode on both sides; return its steps. The last one's trajectory is in its result."""
    results: dict[str, StepResult] = {}
    for name, simulator in sides.items():
        results[name] = await simulator.reset(trial.model_dump_json(), TRACK, b"", Encoding.RAW)
    step = 0
    while True:
        local, ray = results.values()
        assert local == ray, f"{trial.id} differs after {step} steps"
        if local.terminated or local.truncated:
            return step
        step += 1
        for name, simulator in sides.items():
            began = time.perf_counter()
            results[name] = await simulator.step(action(step, number), Encoding.RAW)
            taken[name].append(time.perf_counter() - began)


def bare(ours: socket.socket, theirs: socket.socket, size: int, times: int) -> list[float]:
    """Seconds of round trips between two processes."""
    if os.fork() == 0:
        ours.close()
        reply = bytes(size)
        while theirs.recv(_REQUEST, socket.MSG_WAITALL):
            theirs.sendall(reply)
        os._exit(0)
    theirs.close()
    taken = []
    for _ in range(times):
        began = time.perf_counter()
        ours.sendall(bytes(_REQUEST))
        ours.recv(size, socket.MSG_WAITALL)
        taken.append(time.perf_counter() - began)
    ours.close()
    os.wait()
    return taken


def tcp_pair() -> tuple[socket.socket, socket.socket]:
    """Two ends of a TCP connection of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
    for end in (ours, theirs):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return ours, theirs


def percentiles(seconds: Iterable[float]) -> dict[str, float]:
    """The median, the mean and the 99th percentile, in milliseconds."""
    some = sorted(seconds)
    parts = {"p50": statistics.median(some), "mean": statistics.mean(some), "p99": some[int(0.99 * len(some))]}
    return {name: round(1e3 * value, 3) for name, value in parts.items()}


async def measure(nodes: Nodes, home: Path, count: int) -> tuple[dict[str, list[float]], int, int]:
    """Drive the episodes; return the seconds of steps on both sides, the number of episodes with traffic, and bytes."""
    settings = Settings(home=home, simulators="ray")
    programs = Programs(RaySettings(ray_address=nodes.address, ray_listen="127.0.0.1:0"))
    await programs.open()
    sides: dict[str, Simulator] = {}
    try:
        sides["local"] = await LocalStarter(start_timeout_s=120, timeout_s=60).start()
        sides["Ray"] = await RayStarter(programs, settings).start()
        taken: dict[str, list[float]] = {name: [] for name in sides}
        driven = trials(count)
        for number, trial in enumerate(driven):
            await compare(number, trial, sides, taken)
        shown = await sides["local"].reset(driven[0].model_dump_json(), TRACK, b"", Encoding.RAW)
    finally:
        for simulator in sides.values():
            await simulator.close()
        await programs.close()
    return taken, sum(trial.traffic != Traffic() for trial in driven), len(shown.observation)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--episodes", type=int, default=100)
    given = options.parse_args()
    count = 1 if given.short else given.episodes
    with Nodes(workers=1 if given.short else 3) as nodes, tempfile.TemporaryDirectory() as home:
        os.environ.update(nodes.environment)
        taken, traffic, size = uvloop.run(measure(nodes, Path(home), count))
    taken["bare socket pair"] = bare(*socket.socketpair(), size, _BARE)
    taken["bare TCP"] = bare(*tcp_pair(), size, _BARE)
    steps = len(taken["local"])
    print(f"{count} episodes, {traffic} with traffic, {steps} steps with {size} bytes each: the same bytes")
    times = {name: percentiles(seconds) for name, seconds in taken.items()}
    for name, found in times.items():
        print(f"{name:<17}p50 {found['p50']:.3f}   mean {found['mean']:.3f}   p99 {found['p99']:.3f} ms")
    finish({"step_ms": times, "episodes": count, "traffic": traffic, "steps": steps}, given)


if __name__ == "__main__":
    main()
