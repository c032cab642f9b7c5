"""How slow a model may be."""

import threading
from typing import Final

from wrongturn_runner.conversation import ModelAtFaultError

LOAD_S: Final = 5.0
"""Seconds in which a model has to load."""
CHECK_DEADLINE_S: Final = 2.0
"""Longest step of a check, seconds, so that a model which hangs is refused soon."""
DRIVE_DEADLINE_S: Final = 10.0
"""Longest step of a drive, seconds. A machine that hangs for a while must cost no evaluation."""
CHECK_LIFE_S: Final = 60.0
"""Processor time of a sandbox in a check, seconds."""
DRIVE_LIFE_S: Final = 7 * 86400.0
"""The same in a drive: as long as an evaluation may take by default."""
PATIENCE_S: Final = 1800.0
"""Seconds for which a runner repeats a call, such as a reset while all simulators are busy."""
REPLY_S: Final = 120.0
"""Seconds for which a runner waits for a reply. A reset may load a town, or start a simulator more than once."""
CHECK_STEP_S: Final = 0.5
"""Seconds that a step of the check may take on average.

An evaluation has about 15,000 steps, so such a model drives for two hours. A model that decides in time for a real car,
in 0.1 s, passes even where the machine gives it a fifth of a processor.
"""
DRIVE_STEP_S: Final = 1.0
"""Seconds that a step of a drive may take on average: twice the check's, so that a busy machine fails no model."""
_STEPS: Final = 100
"""Steps of a drive before its average counts."""


class Pace:
    """Time that a model took for its steps; it refuses a model that takes too long. Threads may share it."""

    def __init__(self, average_s: float, steps: int = _STEPS) -> None:
        """Allow a step ``average_s`` on average. Before so many steps, the time of that many steps is the limit."""
        self._average_s = average_s
        self._least = steps
        self.steps_s: list[float] = []
        """Seconds of the first steps, as many as count at least."""
        self._taken_s = 0.0
        self._steps = 0
        self._lock = threading.Lock()

    def add(self, seconds: float) -> None:
        """Add a step. Raises ModelAtFaultError if the model is too slow."""
        with self._lock:
            self._steps += 1
            self._taken_s += seconds
            if self._steps <= self._least:
                self.steps_s.append(seconds)
            steps, taken_s = self._steps, self._taken_s
        if taken_s > self._average_s * max(steps, self._least):
            raise ModelAtFaultError(
                f"too slow: {steps} step{'s' if steps > 1 else ''} of the model took {taken_s:.1f} s together; "
                f"{self._average_s} s a step is the limit, because an evaluation has about 15,000 steps; make the "
                "model smaller"
            )
