"""What the judge refuses.

::

    SimError
    └── JudgeError (ValueError)
        ├── GeometryMismatchError    the geometry is not the trial's
        └── RowError                 a row is not finite, or not after the one before it
"""

from wrongturn_sim.errors import SimError


class JudgeError(SimError, ValueError):
    """Anything that the judge refuses."""


class GeometryMismatchError(JudgeError):
    """The geometry is not that of the trial's approach or of the trajectory's town."""


class RowError(JudgeError):
    """A row is not finite, or its time is not after the last one's."""
