"""Errors of the judge.

::

    SimError
    └── JudgeError (ValueError)
        ├── GeometryMismatchError    the geometry is not the trial's
        └── RowError                 a row is not finite, or not after the one before it
"""

from wrongturn_sim.errors import SimError


class JudgeError(SimError, ValueError):
    """Base class of the judge's errors."""


class GeometryMismatchError(JudgeError):
    """The geometry belongs to another approach or another town."""


class RowError(JudgeError):
    """A row is not finite, or its time is not after the row before."""
