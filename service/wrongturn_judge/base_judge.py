"""What the judges of a junction and of a journey share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import decide
from wrongturn_judge.errors import RowError
from wrongturn_judge.packing import Floats
from wrongturn_protocol import Flag, Outcome, Verdict

if TYPE_CHECKING:
    from wrongturn_judge.trajectory import Row

NOBODY: Final = np.empty((0, 6))
"""Array of no road users."""
VERDICTS: Final = (None, *Verdict)
"""Verdict by the kernels' number; 0 is none."""
FLAGS: Final = {
    decide.KERB_BITE: Flag.KERB_BITE,
    decide.LANE_INVASION: Flag.LANE_INVASION,
    decide.WRONG_WAY_FLAG: Flag.WRONG_WAY,
    decide.OVER_LINE: Flag.OVER_LINE,
    decide.OPPOSED_LANE: Flag.OPPOSED_LANE,
}
"""Flag by the kernels' bit."""


class BaseJudge(ABC):
    """The state of one episode's judgement, and its outcome once there is one.

    Args:
        standing: floats of the state, as ``decide.py`` defines them.
        counts: ints of the state, likewise.
    """

    def __init__(self, standing: Floats, counts: NDArray[np.int64]) -> None:
        self._standing = standing
        self._counts = counts
        self.outcome: Outcome | None = None
        """The outcome; None before there is a verdict."""
        self.ran_out = False
        """Whether the episode ended because its time ran out."""

    def observe(self, row: Row) -> Outcome | None:
        """Take the next row.

        Returns:
            The outcome at the row that decides it; None for rows before and after.

        Raises:
            RowError: the row is not finite, or not later than the one before.
        """
        if self.outcome is not None:
            return None
        found = self._take(row, np.array(row.road_users, np.float64) if row.road_users else NOBODY)
        if not found:
            return None  # so it is for nearly every row
        return self._fall(found, row.t)

    def abort(self, t: float) -> Outcome:
        """End the episode because the agent gave up or stayed away.

        Returns:
            The outcome ``aborted`` at ``t``, or the earlier outcome of an episode that had ended.
        """
        if self.outcome is None:
            self._standing[decide.S_T] = t
            self._counts[decide.D_VERDICT] = decide.ABORTED
            return self._close()
        return self.outcome

    def _fall(self, found: int, t: float) -> Outcome:
        """Return the outcome for a kernel's result that is not 0; raises RowError for a row that cannot be judged."""
        if found == decide.NOT_LATER:
            before = float(self._standing[decide.S_T])
            raise RowError(f"t: {t} s is not after the row before, {before} s; give the rows in order")
        if found < 0:
            raise RowError(f"row at t = {t} s: x, y, yaw or v is not finite; give numbers")
        return self._close()

    def _close(self) -> Outcome:
        self.ran_out = bool(self._counts[decide.D_RAN_OUT])
        self.outcome = self._conclude()
        return self.outcome

    @abstractmethod
    def _take(self, row: Row, users: Floats) -> int:
        """Give a row to the kernel, and return its result."""

    @abstractmethod
    def _conclude(self) -> Outcome:
        """Return the outcome, from the state."""
