"""What a service carries with more simulators than one machine has: a queueing model of a step, run by SimPy.

``python -m lab.load_model FILE`` reads the figures of ``benchmarks/load.py --json FILE`` and prints the tables of
``docs/performance.md``: how well the model foretells what was measured, and what it foretells for a cluster.

A step takes processor time of the agent, of the service's one thread, and of a simulator; each is drawn from an
exponential distribution with the measured mean, which includes the resets. On the measured machine all three share its
processors. In a cluster the agents have machines of their own, and four simulators share a processor.
"""

import json
import statistics
import sys
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import simpy

from lab.tables import Row, Table

STEPS: Final = 12_000
"""Steps of an evaluation: 120 episodes of 100."""
COUNTS: Final = (1, 8, 32, 64, 128, 256, 512, 1000)
"""Simulators in the table of the cluster; each has an agent of its own that drives."""
PER_PROCESSOR: Final = 4
_WARM_S, _SECONDS = 1.0, 5.0
"""Simulated seconds before and while steps are counted."""
_SEED: Final = 31
_FITS: Final = 4
"""Rounds of the fit; the rates hardly change after the second."""


@dataclass(frozen=True)
class Load:
    """Seconds of processor time that one step takes, and where it takes them."""

    service: float
    simulator: float
    client: float
    """Of the client's part alone."""
    think: float = 0.0
    """Of the agent, on a machine of its own."""
    hop: float = 0.0
    """Seconds on the network between service and simulator, both ways."""
    processors: int | None = None
    """Processors that all share; None for a cluster."""
    services: int = 1


@dataclass(frozen=True)
class Flow:
    """What comes of it."""

    steps_per_s: float
    step_s: float
    """Median time of a step, as the agent sees it."""
    busy: float
    """Share of the time for which the service's thread works."""

    @property
    def evaluations_per_h(self) -> float:
        """Return how many evaluations that are in an hour."""
        return 3600.0 * self.steps_per_s / STEPS


def flow(load: Load, simulators: int, seed: int = _SEED) -> Flow:
    """Run the model with so many simulators, each driven by an agent that always has another step."""
    random = np.random.default_rng(seed)
    world = simpy.Environment()
    shared = simpy.Resource(world, load.processors) if load.processors else None
    nodes = shared or simpy.Resource(world, max(1, simulators // PER_PROCESSOR))
    threads = [simpy.Resource(world, 1) for _ in range(load.services)]
    took: list[float] = []
    worked = 0.0

    def work(mean: float, *resources: simpy.Resource | None) -> Generator[Any, Any, None]:
        held = []
        for resource in resources:
            if resource is not None:
                held.append(resource.request())
                yield held[-1]
        yield world.timeout(random.exponential(mean))
        for resource, request in zip([one for one in resources if one is not None], held, strict=True):
            resource.release(request)

    def agent(number: int) -> Generator[Any, Any, None]:
        nonlocal worked
        thread = threads[number % len(threads)]
        while True:
            if load.think:
                yield world.timeout(random.exponential(load.think))
            yield from work(load.client, shared)
            began = world.now
            # The service reads the call, and later the simulator's reply.
            yield from work(load.service / 2, thread, shared)
            yield world.timeout(load.hop)
            yield from work(load.simulator, nodes)
            yield from work(load.service / 2, thread, shared)
            if world.now >= _WARM_S:
                took.append(world.now - began)
                worked += load.service

    for number in range(simulators):
        world.process(agent(number))
    world.run(_WARM_S + _SECONDS)
    return Flow(len(took) / _SECONDS, statistics.median(took), worked / _SECONDS / load.services)


def fitted(cases: list[dict[str, Any]], processors: int) -> tuple[Load, float]:
    """Return the load of cases that were measured on one machine, and the factor that fits it.

    The processor times are those measured, times a factor: what caches, the kernel and waking up cost when several
    processes share the processors. It makes the mean logarithm of foretold to measured rates zero.
    """

    def middle(group: str) -> float:
        return float(statistics.median(case["processor_ms"][group] for case in cases)) / 1000

    bare = Load(middle("service"), middle("simulators"), middle("clients"), processors=processors)
    load, factor = bare, 1.0
    for _ in range(_FITS):
        told = [flow(load, case["simulators"]).steps_per_s / case["steps_per_s"] for case in cases]
        factor *= statistics.geometric_mean(told)
        load = replace(
            bare, service=factor * bare.service, simulator=factor * bare.simulator, client=factor * bare.client
        )
    return load, factor


def measured_rows(cases: list[dict[str, Any]], load: Load) -> list[Row]:
    """Return for each case what was measured beside what the model foretells."""
    rows: list[Row] = []
    for case in cases:
        told = flow(load, case["simulators"])
        rows.append(
            (
                "Ray" if case["nodes"] else "local",
                str(case["simulators"]),
                f"{case['steps_per_s']:,.0f}",
                f"{told.steps_per_s:,.0f}",
                f"{case['step_ms']:.2f}",
                f"{1000 * told.step_s:.2f}",
            )
        )
    return rows


def cluster_rows(load: Load) -> list[Row]:
    """Return what the model foretells for clusters, with one service and with two."""
    rows: list[Row] = []
    for count in COUNTS:
        one, two = flow(load, count), flow(replace(load, services=2), count)
        rows.append(
            (
                f"{count:,}",
                str(max(1, count // PER_PROCESSOR)),
                f"{one.steps_per_s:,.0f}",
                f"{one.evaluations_per_h:,.0f}",
                f"{1000 * one.step_s:.1f}",
                f"{one.busy:.0%}",
                f"{two.evaluations_per_h:,.0f}",
            )
        )
    return rows


def processor_hours(load: Load, evaluations: int) -> dict[str, float]:
    """Return the hours of one processor that evaluations take: service, simulators, and the client's part."""
    steps = evaluations * STEPS / 3600
    return {"service": steps * load.service, "simulators": steps * load.simulator, "clients": steps * load.client}


def main() -> None:
    """Print the tables."""
    told = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    think = float(sys.argv[2]) / 1000 if len(sys.argv) > 2 else 0.002
    for nodes in sorted({case["nodes"] for case in told["cases"]}):
        cases = [case for case in told["cases"] if case["nodes"] == nodes]
        load, factor = fitted(cases, told["processors"])
        print(f"{nodes} nodes: processor times as measured, times {factor:.2f}")
        head: Row = ("where", "simulators", "steps/s", "model", "a step, ms", "model")
        print(Table("", head, measured_rows(cases, load), words=1).markdown())
        cluster = replace(load, processors=None, think=think, hop=0.0005)
        print(f"\n{cluster}\n")
        head = ("simulators", "processors", "steps/s", "evaluations/h", "a step, ms", "thread busy", "two services")
        print(Table("", head, cluster_rows(cluster), words=0).markdown())
        print({name: round(hours, 2) for name, hours in processor_hours(load, 1000).items()}, "\n")


if __name__ == "__main__":
    main()
