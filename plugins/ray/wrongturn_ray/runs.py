"""Runs on a Ray cluster: each is a task, and its program runs on the node that Ray chooses."""

import logging
import math
import os
import signal
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import ray

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.job import Job, Started, failure_of
from wrongturn_agents.training.side_by_side import watch
from wrongturn_ray.driver import check_answer

_RETRIES: Final = 5
"""How often a run whose node died starts on another one. It resumes there."""
_AWAKE: Final = 0.2


def train_on_ray(
    made: Callable[..., list[Job]], runs: int, directory: Path, threads: int | None, gpus: float | None
) -> tuple[list[Job], dict[Job, str]]:
    """Train on the cluster; return the jobs, and why those that failed did.

    ``made`` plans the jobs, with the threads that each gets.
    """
    with cluster():
        threads, gpus = shares(runs, threads, gpus)
        jobs = made(threads=threads)
        with start_on_ray(jobs, directory, threads=threads, gpus=gpus) as started:
            return jobs, watch(started)


@contextmanager
def cluster() -> Iterator[None]:
    """Connect to the cluster of ``RAY_ADDRESS``, or to that which runs on this machine.

    Raises:
        TrainingError: There is no cluster.
    """
    address = os.environ.get("RAY_ADDRESS") or "auto"
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        check_answer(address)
        ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
    except (OSError, ValueError) as error:
        raise TrainingError(
            f"--ray: there is no cluster at {address!r}; start one with 'ray start --head', or name it in RAY_ADDRESS"
        ) from error
    # Ray aborts a program at SIGTERM. This one lets its runs save.
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    try:
        yield
    finally:
        ray.shutdown()


def shares(runs: int, threads: int | None, gpus: float | None) -> tuple[int, float]:
    """Return the cores and the GPUs of each run: by default, all run at once and share what the cluster has."""
    cores = [node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"]]
    there = ray.cluster_resources().get("GPU", 0)
    if threads is None:
        threads = max(1, int(min(sum(cores) / runs, max(cores, default=1))))
    if gpus is None:
        gpus = 1.0 / math.ceil(runs / there) if there else 0.0
    return threads, gpus


@contextmanager
def start_on_ray(jobs: Sequence[Job], directory: Path, *, threads: int, gpus: float) -> Iterator[dict[Job, Started]]:
    """Hand jobs to the cluster. Their directory must be on a file system that this machine and the nodes share."""
    with tempfile.NamedTemporaryFile(dir=directory, prefix=".shared-") as probe:
        task = ray.remote(num_cpus=threads, num_gpus=gpus, max_retries=_RETRIES)(_run)
        yield {job: _OnRay(task.options(name=job.name).remote(job, Path(probe.name).absolute())) for job in jobs}


def _run(job: Job, probe: Path) -> str:
    """Run a job's program on this node, and return why it failed; an empty text if it did not."""
    if not probe.is_file():
        return (
            f"node {socket.gethostname()} has no {probe.parent} of the machine that asks; "
            "name a --directory on a file system that all nodes share"
        )
    process = job.start()
    try:
        while process.poll() is None:  # Ray's cancellation does not interrupt a system call
            time.sleep(_AWAKE)
    except KeyboardInterrupt:
        process.terminate()
        process.wait()
        raise
    return failure_of(job, process.returncode)


class _OnRay:
    """A job on the cluster."""

    def __init__(self, reference: Any) -> None:
        self._reference = reference

    def failure(self) -> str | None:
        if not ray.wait([self._reference], timeout=0)[0]:
            return None
        try:
            return str(ray.get(self._reference))
        except ray.exceptions.RayError as error:
            return next(reversed(str(error).strip().splitlines()), type(error).__name__)

    def stop(self, *, now: bool) -> None:
        ray.cancel(self._reference, force=now)
