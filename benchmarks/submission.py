"""How long a submission takes, against the same model's own worker, in turns at one service.

    .venv/bin/python benchmarks/submission.py [MODEL.onnx] [--suite wrong-command@3] [--rounds 2] [--json F] [--short]

Each round drives the suite by ``wrongturn run MODEL.onnx`` and then by ``wrongturn submit MODEL.onnx``. Prints the wall
time and the processor time of each, by all processes together: the service and its simulators too. Other programs spoil
the wall time, and the processor time much less: the load is printed. ``--short`` drives smoke@3 once, to see that this
still runs.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_client import Client, LocalService

RUN, SUBMIT = "run", "submit"
MODEL = Path(__file__).parents[1] / "agents/wrongturn_agents/weights/ppo-segmentation.onnx"
_LOOK_S = 0.25


class ProcessorTime:
    """Processor time of some processes and all below them while the ``with`` block runs."""

    def __init__(self, *pids: int) -> None:
        self._pids = list(pids)
        self._before = self._look()
        self._seen: dict[int, float] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def add(self, pid: int) -> None:
        self._pids.append(pid)

    def __enter__(self) -> "ProcessorTime":
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._over.set()
        self._thread.join()

    @property
    def seconds(self) -> float:
        return sum(seconds - self._before.get(pid, 0.0) for pid, seconds in self._seen.items())

    def _watch(self) -> None:
        while not self._over.wait(_LOOK_S):
            self._seen |= self._look()
        self._seen |= self._look()

    def _look(self) -> dict[int, float]:
        found = {}
        for pid in self._pids:
            with contextlib.suppress(psutil.Error):
                for process in (root := psutil.Process(pid), *root.children(recursive=True)):
                    with contextlib.suppress(psutil.Error):
                        times = process.cpu_times()
                        found[process.pid] = times.user + times.system
        return found


def drive(service: LocalService, token: str, how: str, options: argparse.Namespace) -> dict[str, float]:
    name = f"{how} {time.time_ns() // 1000}"
    arguments = [str(options.model), "--suite", options.suite, "--url", service.url, "--name", name]
    load = os.getloadavg()[0]
    with ProcessorTime(service.pid) as processor:
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "wrongturn_client", how, *arguments],
            env=os.environ | {"WRONGTURN_OWNER_TOKEN": token},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        processor.add(process.pid)
        _, said = process.communicate()
        wall = time.perf_counter() - begin
    assert process.returncode == 0, said
    return {"wall_s": wall, "processor_s": processor.seconds, "load_before": load}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path, nargs="?", default=MODEL)
    parser.add_argument("--suite", default="wrong-command@3")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--short", action="store_true", help="one round of smoke@3, to see that it runs")
    options = parser.parse_args()
    if options.short:
        options.suite, options.rounds = "smoke@3", 1
    found: dict[str, list[dict[str, float]]] = {RUN: [], SUBMIT: []}
    with tempfile.TemporaryDirectory() as folder:
        database = f"sqlite+aiosqlite:///{folder}/wrongturn.db"
        with LocalService(
            database=database, environment={"WRONGTURN_HOME": folder, "WRONGTURN_SUBMISSIONS": "1"}
        ) as service:
            with Client(service.url) as client:
                token = client.register_owner("benchmark").token
            for _ in range(options.rounds):
                for how, figures in found.items():
                    figures.append(drive(service, token, how, options))
                    print(f"{how}: {figures[-1]}", flush=True)
    for figure in ("wall_s", "processor_s"):
        ratios = [b[figure] / a[figure] for a, b in zip(found[RUN], found[SUBMIT], strict=True)]
        print(f"{figure}: submit takes {statistics.median(ratios):.2f} times what run takes ({ratios})")
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
