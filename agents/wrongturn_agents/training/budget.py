"""How much of a run is over: by its steps or by the clock, whichever comes first."""

import time
from collections.abc import Callable
from typing import Final

from wrongturn_agents.training.errors import TrainingError

NO_LIMIT: Final = 10**12
"""Steps where the clock alone ends a run."""


class Budget:
    """The steps and the minutes that a run may take.

    A run that was interrupted goes on with what it had used. What is learnt hangs on the clock only where minutes
    were asked for.

    Args:
        steps: environment steps; None where minutes alone count.
        minutes: of wall clock from now on, with everything: pretraining, compiling and evaluations.
        used: seconds that the run had used before it was interrupted.
        clock: seconds that only go up.

    Raises:
        TrainingError: neither was given, or one is not positive.
    """

    def __init__(
        self,
        steps: int | None,
        minutes: float | None,
        *,
        used: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if steps is None and minutes is None:
            raise TrainingError("steps: give steps, minutes or both; a run must end")
        for name, value in (("steps", steps), ("minutes", minutes)):
            if value is not None and not 0 < value <= NO_LIMIT:
                raise TrainingError(f"{name}: is {value}; give a number above 0, of at most {NO_LIMIT}")
        self.steps = NO_LIMIT if steps is None else steps
        self.seconds = None if minutes is None else 60.0 * minutes
        self.reserve = 0.0 if self.seconds is None else min(60.0, 0.1 * self.seconds)
        """Seconds kept for what comes after learning, the last evaluation: a guess, until there was one."""
        self.begun = 0.0
        """Seconds used when learning began: compiling and pretraining are within the minutes, not the schedule."""
        self._clock = clock
        self._begin = clock() - used

    @property
    def used(self) -> float:
        """Seconds so far, those before an interruption included."""
        return self._clock() - self._begin

    def fraction(self, steps: int) -> float:
        """How much of the learning is over after so many steps, 0 to 1."""
        by_clock = 0.0
        if self.seconds is not None:
            by_clock = (self.used - self.begun) / max(self.seconds - self.reserve - self.begun, 1e-9)
        return min(1.0, max(steps / self.steps, by_clock))

    def over(self, steps: int = 0) -> bool:
        """Whether learning is to end now."""
        return self.fraction(steps) >= 1.0

    def out_of_time(self) -> bool:
        """Whether all minutes are used but for writing the files."""
        return self.seconds is not None and self.used >= self.seconds - min(2.0, 0.02 * self.seconds)
