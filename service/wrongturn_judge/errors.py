"""Errors of the judge.

::

    JudgeError (ValueError)
    ├── TrajectoryError          the bytes are not a trajectory
    ├── GeometryMismatchError    the geometry is not the trial's
    ├── RowError                 a row is not finite, or not after the one before it
    └── RecordingError           a drive that was recorded elsewhere cannot be judged
"""


class JudgeError(ValueError):
    """Base class of the judge's errors."""


class TrajectoryError(JudgeError):
    """The bytes are not a trajectory."""


class GeometryMismatchError(JudgeError):
    """The geometry belongs to another approach or another town."""


class RowError(JudgeError):
    """A row is not finite, or its time is not after the row before."""


class RecordingError(JudgeError):
    """A recording cannot be judged. It names the field, the row if one is to blame, and the remedy."""

    def __init__(self, field: str, problem: str, row: int | None = None) -> None:
        self.field, self.problem, self.row = field, problem, row
        super().__init__(f"{field if row is None else f'{field}.{row}'}: {problem}")
