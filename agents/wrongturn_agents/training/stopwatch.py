"""Measurement of where a run's time goes."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch


class Stopwatch:
    """Seconds spent in each part of a run. Time in a nested part counts only for the nested part.

    On CUDA the end of a part waits for the device; otherwise the time would count for the next part that needs the
    result. This costs nothing in the training loop, where each part needs the result of the one before.
    """

    def __init__(self, device: torch.device, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._cuda = device.type == "cuda"
        self._clock = clock
        self._inner = [0.0]
        self._begin = clock()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time within the block for a part."""
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
        """Return the seconds by part since the last lap, with ``rest`` and ``whole``, and start again at 0."""
        now = self._clock()
        whole = now - self._begin
        found = dict(self.seconds)
        found["rest"] = whole - sum(found.values())
        found["whole"] = whole
        self.seconds.clear()
        self._begin = now
        return found
