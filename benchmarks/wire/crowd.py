"""Client processes that take steps at the same time."""

import contextlib
import multiprocessing
import time
from collections.abc import Callable, Iterator
from typing import Any

AHEAD_S = 0.1
"""From the word to the beginning, so that all have heard it."""
Ways = dict[str, Callable[[], None]]


class Crowd:
    """So many processes, each with all ways open."""

    def __init__(self, pipes: list[Any]) -> None:
        self.pipes = pipes

    def rate(self, way: str, clients: int, seconds: float) -> tuple[float, list[float]]:
        """Steps a second of the first so many together; and the seconds of each step."""
        begin = time.monotonic() + AHEAD_S
        for pipe in self.pipes[:clients]:
            pipe.send((way, begin, begin + seconds))
        told = [pipe.recv() for pipe in self.pipes[:clients]]
        for one in told:
            if isinstance(one, str):
                raise RuntimeError(f"{way}: {one}")
        return sum(len(one) / max(seconds, sum(one)) for one in told), [took for one in told for took in one]


def _serve(make: Callable[[], Ways], pipe: Any) -> None:
    ways = make()
    for step in ways.values():
        step()  # whatever is started by the first
    pipe.send("ready")
    with contextlib.suppress(EOFError):
        while True:
            way, begin, end = pipe.recv()
            try:
                pipe.send(_steps(ways[way], begin, end))
            except Exception as error:
                pipe.send(f"{type(error).__name__}: {error}")


def _steps(step: Callable[[], None], begin: float, end: float) -> list[float]:
    """The seconds of the steps that began in time, one at least; before the beginning it is made warm."""
    while time.monotonic() < begin:
        step()
    took = []
    now = time.perf_counter()
    while not took or time.monotonic() < end:
        step()
        before, now = now, time.perf_counter()
        took.append(now - before)
    return took


@contextlib.contextmanager
def crowd(make: Callable[[], Ways], count: int) -> Iterator[Crowd]:
    """Processes forked from this one; each makes its own ways."""
    fork = multiprocessing.get_context("fork")
    pipes, processes = [], []
    for _ in range(count):
        here, there = fork.Pipe()
        process = fork.Process(target=_serve, args=(make, there), daemon=True)
        process.start()
        there.close()
        pipes.append(here)
        processes.append(process)
    try:
        for pipe in pipes:
            assert pipe.recv() == "ready"
        yield Crowd(pipes)
    finally:
        for process in processes:
            process.terminate()
            process.join()
