"""Where a run's time goes."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch


class Stopwatch:
    """Seconds by part; a part within another counts for the inner one alone.

    On CUDA work is waited for at the end of a part, else it would be counted for whoever needs its result first. In
    the training loop that costs nothing: each part's result is needed by the next.

    Args:
        device: whose work is waited for.
        clock: seconds that only go up.
    """

    def __init__(self, device: torch.device, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._cuda = device.type == "cuda"
        self._clock = clock
        self._inner = [0.0]
        self._begin = clock()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count what is done within for this part."""
        begin = self._clock()
        self._inner.append(0.0)
        try:
            yield
        finally:
            if self._cuda:
                torch.cuda.synchronize()
            whole = self._clock() - begin
            self.seconds[name] += whole - self._inner.pop()
            self._inner[-1] += whole

    def lap(self) -> dict[str, float]:
        """The seconds since the last lap by part, ``rest`` for what no part covers, ``whole`` for all; begins anew."""
        now = self._clock()
        whole = now - self._begin
        found = dict(self.seconds)
        found["rest"] = whole - sum(found.values())
        found["whole"] = whole
        self.seconds.clear()
        self._begin = now
        return found
