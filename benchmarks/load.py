"""Steps and evaluations an hour against simulators, on this machine and on a Ray cluster of several nodes on it.

    .venv/bin/python benchmarks/load.py [--simulators 1 2 4 8] [--nodes 0 3] [--seconds 10] [--json FILE] [--short]

As many clients as simulators, each a process with a connection of its own, drive practice episodes of 100 steps in
Town01 in the track ``segmentation`` over ``/v1/drive`` for some seconds. ``--nodes 0`` is this machine without Ray.
Prints steps a second, a step's time, and the processor time that service, simulators and clients take for a step.
``lab/load_model.py`` reads the file.
"""

import contextlib
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from common import finish, parser, processor_s

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_client import Action, Client, LocalService
from wrongturn_protocol import PracticeRequest, Track

STEPS: Final = 100
"""Steps of an episode; those of ``wrong-command@3`` have 60 to 150."""
EPISODES: Final = 120
"""Episodes of an evaluation: 60 trials and their twins."""
_ACTION: Final = Action(steer=0.0, throttle=0.2, brake=0.0)
_WARM_S: Final = 3.0
_SIMULATORS: Final = (b"wrongturn_service.simulators", b"wrongturn_ray.serve")


def drive(url: str, token: str, number: int, pipe: Any) -> None:
    """Drive one episode after the other until the end that the pipe names; send the seconds of resets and steps."""
    with Client(url, token) as client, client.drive() as socket:
        pipe.send("connected")
        begin, end = pipe.recv()
        resets: list[float] = []
        steps: list[float] = []
        seed = 1000 * number
        while (now := time.monotonic()) < end or not steps:
            seed += 1
            episode = socket.practise(PracticeRequest(town="Town01", approach="J12-E", seed=seed))
            if now >= begin:
                resets.append(time.monotonic() - now)
            for seq in range(1, STEPS + 1):
                before = time.monotonic()
                reply = socket.step(episode.id, seq, _ACTION)
                after = time.monotonic()
                if begin <= before and (after <= end or not steps):
                    steps.append(after - before)
                if reply.terminated or reply.truncated or (after >= end and steps):
                    break
            if not (reply.terminated or reply.truncated):
                socket.abort_episode(episode.id)
        pipe.send((resets, steps))


def simulators() -> list[int]:
    """Return the processes of simulators that this one has started, also by a service or by Ray."""
    parents: dict[int, int] = {}
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            words = (folder / "cmdline").read_bytes()
            if any(program in words for program in _SIMULATORS):
                found.append(int(folder.name))

    def ours(pid: int) -> bool:
        return pid == os.getpid() or (pid in parents and ours(parents[pid]))

    return [pid for pid in found if ours(pid)]


def processor(pids: list[int]) -> float:
    """Return the processor time of processes, seconds."""
    return sum(processor_s(pid) for pid in pids)


def measure(url: str, token: str, service: int, count: int, seconds: float) -> dict[str, Any]:
    """Let so many clients drive, and return what was measured while all did."""
    context = multiprocessing.get_context("spawn")
    pipes, clients = [], []
    for number in range(count):
        here, there = context.Pipe()
        client = context.Process(target=drive, args=(url, token, number, there), daemon=True)
        client.start()
        pipes.append(here)
        clients.append(client)
    for pipe in pipes:
        pipe.recv()
    begin = time.monotonic() + _WARM_S
    for pipe in pipes:
        pipe.send((begin, begin + seconds))
    time.sleep(max(0.0, begin - time.monotonic()))
    groups = {"service": [service], "simulators": simulators(), "clients": [c.pid for c in clients if c.pid]}
    before = {name: processor(pids) for name, pids in groups.items()}
    time.sleep(max(0.0, begin + seconds - time.monotonic()))
    used = {name: processor(pids) - before[name] for name, pids in groups.items()}
    told = [pipe.recv() for pipe in pipes]
    for client in clients:
        client.join()
    steps = [step for _, each in told for step in each]
    resets = [reset for each, _ in told for reset in each]
    return {
        "simulators": count,
        "steps_per_s": len(steps) / seconds,
        "evaluations_per_h": 3600 * len(steps) / seconds / STEPS / EPISODES,
        "resets": len(resets),
        "step_ms": 1000 * statistics.median(steps),
        "reset_ms": 1000 * statistics.median(resets) if resets else None,
        "processor_ms": {name: 1000 * value / len(steps) for name, value in used.items()},
    }


@contextlib.contextmanager
def cluster(nodes: int, each: int) -> Iterator[dict[str, str]]:
    """Start a Ray cluster with so many nodes beside its head; yield the service's settings. 0 nodes are none."""
    if not nodes:
        yield {"WRONGTURN_SIMULATORS": str(each)}
        return
    from ray.cluster_utils import Cluster  # noqa: PLC0415

    started = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        for _ in range(nodes):
            started.add_node(num_cpus=-(-each // (4 * nodes)))
        started.wait_for_nodes()
        yield {"WRONGTURN_SIMULATORS": f"ray:{each}", "WRONGTURN_RAY_ADDRESS": started.address}
    finally:
        started.shutdown()


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--simulators", type=int, nargs="+", default=[1, 2, 4, 8])
    options.add_argument("--nodes", type=int, nargs="+", default=[0, 3])
    options.add_argument("--seconds", type=float, default=10.0)
    given = options.parse_args()
    if given.short:
        given.simulators, given.nodes, given.seconds = [1], [0], 0.5
    cases = []
    for nodes in given.nodes:
        most = max(given.simulators)
        with tempfile.TemporaryDirectory() as folder, cluster(nodes, most) as settings:
            environment = {"WRONGTURN_HOME": folder, "WRONGTURN_SPARE_SIMULATORS": "0", **settings}
            with LocalService(environment=environment) as service, Client(service.url) as stranger:
                token = stranger.register("load", Track.SEGMENTATION).token
                for count in given.simulators:
                    one = {"nodes": nodes, **measure(service.url, token, service.pid, count, given.seconds)}
                    cases.append(one)
                    shares = ", ".join(f"{name} {value:.2f}" for name, value in one["processor_ms"].items())
                    print(
                        f"{nodes} nodes, {count:3} simulators: {one['steps_per_s']:6.0f} steps/s, "
                        f"{one['evaluations_per_h']:5.0f} evaluations/h, a step {one['step_ms']:.2f} ms; "
                        f"processor ms a step: {shares}",
                        flush=True,
                    )
    finish({"cases": cases, "processors": os.cpu_count()}, given)


if __name__ == "__main__":
    main()
