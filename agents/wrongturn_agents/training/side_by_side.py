"""Several runs side by side, on this machine or on a Ray cluster: planned, started and watched."""

import os
import sys
import time
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import torch
import typer
from rich.console import Group
from rich.live import Live
from rich.text import Text

from wrongturn_agents.batch.workers import of_ray
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.devices import check_threads, device_of
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.job import LOG, STATE, Job, Started, failure_of
from wrongturn_agents.training.method import Method, find_method
from wrongturn_agents.training.run_directory import BEST, Begun, check_seed, refuse_to_lose
from wrongturn_agents.training.settings import Settings

_MOST: Final = 1000
"""Most runs of one command."""
_AWAKE: Final = 0.2
"""Seconds between two looks at the runs."""
_EVERY: Final = 30.0
"""Seconds between two reports of all runs outside a terminal."""
_WAITS: Final = "begins"


class _Here:
    """A job on this machine."""

    def __init__(self, job: Job, gpu: str | None) -> None:
        self._job = job
        self._process = job.start(**({} if gpu is None else {"CUDA_VISIBLE_DEVICES": gpu}))

    def failure(self) -> str | None:
        code = self._process.poll()
        return None if code is None else failure_of(self._job, code)

    def stop(self, *, now: bool) -> None:
        self._process.kill() if now else self._process.terminate()  # a background shell's programs ignore SIGINT


def seeds_of(text: str) -> list[int]:
    """Return the seeds that ``1-5`` or ``1,3,7-9`` names, in this order.

    Raises:
        TrainingError: it names none, one of them twice, or too many.
    """
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not (first.isdecimal() and (last.isdecimal() if dash else True)):
            raise TrainingError(f"--seeds: {text!r} names no seeds; give a range or a list, such as 1-5 or 1,3,5")
        if dash and int(last) < int(first):
            raise TrainingError(f"--seeds: {text!r} runs backwards; give the smaller seed first, such as 1-5")
        seeds.extend(range(int(first), min(int(last) if dash else int(first), int(first) + _MOST) + 1))
    if not 0 < len(seeds) <= _MOST or len({*seeds}) < len(seeds):
        raise TrainingError(f"--seeds: {text!r} names {len(seeds)} or one of them twice; give 1 to {_MOST}, each once")
    return seeds


def side_by_side(
    algorithms: Sequence[str],
    seeds: Sequence[int],
    *,
    directory: Path,
    ray: bool = False,
    threads: int | None = None,
    gpus: float | None = None,
    **limits: Any,
) -> None:
    """Train algorithms with several seeds each, as ``wrongturn train ppo-image --seeds 1-5`` does; see :func:`plan`.

    Args:
        algorithms: names of methods.
        seeds: seeds of each.
        directory: directory of the runs' directories.
        ray: train on a Ray cluster, not on this machine.
        threads: threads of each run; by default all cores together.
        gpus: with Ray, GPUs of each run; by default all GPUs together.
        limits: the other arguments of :func:`plan`.

    Raises:
        TrainingError: an argument is invalid, or a run failed.
        KeyboardInterrupt: someone stopped the runs. They have saved.
    """
    runs = len(algorithms) * len(seeds)
    if ray:
        made = partial(plan, algorithms, seeds, directory=directory, **limits)
        jobs, failed = of_ray("runs")(made, runs, directory, threads, gpus)
    else:
        if gpus is not None:
            raise TrainingError("--gpus: is for --ray; leave it out")
        places = gpus_here(limits["device"])
        threads = threads or max(1, len(os.sched_getaffinity(0)) // runs)
        jobs = plan(algorithms, seeds, directory=directory, threads=threads, **limits)
        failed = watch(start_here(jobs, places))
    if failed:
        logs = ", ".join(f"{job.name} ({os.path.relpath(job.folder / LOG)})" for job in failed)
        raise TrainingError(f"{len(failed)} of {len(jobs)} runs failed; their logs say why: {logs}")
    typer.echo(f"The best of each run is its {BEST} in {directory}.")


def plan(
    algorithms: Sequence[str],
    seeds: Sequence[int],
    *,
    directory: Path,
    threads: int,
    steps: int | None,
    minutes: float | None,
    device: str,
    resume: bool,
    options: Iterable[str],
) -> list[Job]:
    """Return the runs to start: all but those that have finished.

    Each run has a directory ``ALGORITHM-SEED`` below ``directory``. ``ALGORITHM.name=value`` is an option of one
    algorithm alone. With ``resume``, the command is that with which the runs began: those that have not begun begin.

    Raises:
        TrainingError: an argument is invalid, a run has other options than these, or its directory holds another.
    """
    if len({*algorithms}) < len(algorithms):
        raise TrainingError("ALGORITHM: is named twice; name each once, and give --seeds")
    check_threads(threads)
    if steps is not None or minutes is not None:
        Budget(steps, minutes)
    jobs: list[Job] = []
    for algorithm in algorithms:
        method, own = find_method(algorithm), _options_of(algorithm, algorithms, options)
        settings = method.settings().with_options(own)
        if not resume:
            method.prepare(settings)
        for seed in seeds:
            check_seed(seed)
            folder = directory.absolute() / f"{algorithm}-{seed}"
            limits = [f"--{name}={value}" for name, value in (("steps", steps), ("minutes", minutes)) if value]
            arguments = (algorithm, f"--seed={seed}", f"--directory={folder}", f"--threads={threads}")
            job = Job(folder.name, folder, (*arguments, f"--device={device}", *limits), tuple(own), Path.cwd())
            if not resume:
                refuse_to_lose(folder)
            if resume and _is_over(folder, method, settings, steps, minutes):
                typer.echo(f"{job.name}: has finished")
            else:
                jobs.append(job)
    for job in jobs:
        try:
            job.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise TrainingError(f"directory {job.folder}: cannot be made ({error.strerror}); name another") from error
    return jobs


def _options_of(algorithm: str, algorithms: Sequence[str], options: Iterable[str]) -> list[str]:
    """Return the options that an algorithm gets: its own and those of all."""
    found = []
    for option in options:
        name, dot, rest = option.partition(".")
        mine = dot and name in algorithms
        if not mine or name == algorithm:
            found.append(rest if mine else option)
    return found


def _is_over(folder: Path, method: Method, settings: Settings, steps: int | None, minutes: float | None) -> bool:
    """Return whether a directory holds a run that finished, and check that it is one of these settings."""
    if not (folder / STATE).is_file():
        return False
    begun = Begun.read(folder, method)
    if begun.settings != settings:
        raise TrainingError(
            f"directory {folder}: its run has other options; repeat the command with which it began, and --resume"
        )
    longer = (steps, minutes) != (None, None) and (steps, minutes) != (begun.steps, begun.minutes)
    return begun.finished and not longer


def gpus_here(device: str) -> list[str]:
    """Return the GPUs among which runs on this machine are dealt; an empty list if they run on the CPU."""
    if device_of(device).type == "cpu":
        return []
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    return named.split(",") if named else [str(number) for number in range(torch.cuda.device_count())]


def start_here(jobs: Sequence[Job], gpus: Sequence[str]) -> dict[Job, Started]:
    """Start jobs on this machine, one after the other on each GPU."""
    return {job: _Here(job, gpus[number % len(gpus)] if gpus else None) for number, job in enumerate(jobs)}


def watch(started: dict[Job, Started]) -> dict[Job, str]:
    """Show jobs until all have ended, and return why those that failed did. One that fails does not end the others.

    Ctrl-C lets all save and end; another Ctrl-C ends them now. Then KeyboardInterrupt is raised.
    """
    running, failed, stops = dict(started), dict[Job, str](), 0
    with _Lines([*started]) as lines:
        while running:
            try:
                for job, one in [*running.items()]:
                    if (why := one.failure()) is not None:
                        del running[job]
                        lines.ended(job, "stopped" if stops and why else f"failed: {why}" if why else job.said())
                        failed |= {job: why} if why else {}
                lines.show()
                time.sleep(_AWAKE)
            except (KeyboardInterrupt, SystemExit):
                stops += 1
                lines.tell("All runs save and end. Press Ctrl-C again to end them now." if stops == 1 else "Ends all.")
                for one in running.values():
                    one.stop(now=stops > 1)
    if stops:
        raise KeyboardInterrupt
    return failed


class _Lines:
    """A line for each run: in place in a terminal, otherwise now and then."""

    def __init__(self, jobs: Sequence[Job]) -> None:
        self._ends: dict[Job, str | None] = dict.fromkeys(jobs)
        self._shown_at = time.monotonic()
        self._live = Live(refresh_per_second=2) if sys.stdout.isatty() else None

    def __enter__(self) -> "_Lines":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.update(self._all(), refresh=True)
            self._live.stop()

    def ended(self, job: Job, how: str) -> None:
        """Take note of a job's end."""
        self._ends[job] = how
        if self._live is None:
            typer.echo(f"{job.name}: {how}")

    def tell(self, text: str) -> None:
        """Say something above the lines."""
        typer.echo(text) if self._live is None else self._live.console.print(text)

    def show(self) -> None:
        """Show how far the jobs are."""
        if self._live is not None:
            self._live.update(self._all())
        elif time.monotonic() - self._shown_at >= _EVERY:
            self._shown_at = time.monotonic()
            for job, end in self._ends.items():
                if end is None:
                    typer.echo(f"{job.name}: {job.said() or _WAITS}")

    def _all(self) -> Group:
        texts = (f"{job.name}: {end or job.said() or _WAITS}" for job, end in self._ends.items())
        return Group(*(Text(text, no_wrap=True, overflow="ellipsis") for text in texts))
