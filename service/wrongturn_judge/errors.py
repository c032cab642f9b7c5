"""Errors of the judge.

::

    JudgeError (ValueError)
    ├── TrajectoryError          the bytes are not a trajectory
    ├── GeometryMismatchError    the geometry is not the trial's
    └── RowError                 a row is not finite, or not after the one before it
"""


class JudgeError(ValueError):
    """Base class of the judge's errors."""


class TrajectoryError(JudgeError):
    """The bytes are not a trajectory."""


class GeometryMismatchError(JudgeError):
    """The geometry belongs to another approach or another town."""


class RowError(JudgeError):
    """A row is not finite, or its time is not after the row before."""
