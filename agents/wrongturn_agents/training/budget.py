"""How much of a run is over: by its steps or by the clock, whichever is further on."""

import time
from collections.abc import Callable
from typing import Final

from wrongturn_agents.training.errors import TrainingError

NO_LIMIT: Final = 10**12
"""Number of steps of a run that only the clock ends."""


class Budget:
    """Steps that a run may take, and minutes of the wall clock for everything; None does not count.

    A resumed run continues with the seconds that it had used. Learning depends on the clock only if minutes are given.
    """

    def __init__(
        self, steps: int | None, minutes: float | None, *, used: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        if steps is None and minutes is None:
            raise TrainingError("steps: give steps, minutes or both; a run must end")
        for name, value in (("steps", steps), ("minutes", minutes)):
            if value is not None and not 0 < value <= NO_LIMIT:
                raise TrainingError(f"{name}: is {value}; give a number above 0, of at most {NO_LIMIT}")
        self.steps = NO_LIMIT if steps is None else steps
        self.seconds = None if minutes is None else 60.0 * minutes
        self.reserve = 0.0 if self.seconds is None else min(60.0, 0.1 * self.seconds)
        """Seconds kept for the last evaluation, after learning. A guess until the first evaluation has been timed."""
        self.begun = 0.0
        """Seconds used when learning began. The schedule does not count compiling and pretraining; the minutes do."""
        self._clock = clock
        self._begin = clock() - used

    @property
    def used(self) -> float:
        """Seconds used so far, with those before an interruption."""
        return self._clock() - self._begin

    def fraction(self, steps: int) -> float:
        """Return how much of the learning is over after this many steps, from 0 to 1."""
        by_clock = 0.0
        if self.seconds is not None:
            by_clock = (self.used - self.begun) / max(self.seconds - self.reserve - self.begun, 1e-9)
        return min(1.0, max(steps / self.steps, by_clock))

    def over(self, steps: int = 0) -> bool:
        """Return whether learning must end now."""
        return self.fraction(steps) >= 1.0

    def out_of_time(self) -> bool:
        """Return whether all minutes are used, except the last seconds for writing the files."""
        return self.seconds is not None and self.used >= self.seconds - min(2.0, 0.02 * self.seconds)
