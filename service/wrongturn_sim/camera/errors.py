"""Errors of the camera.

::

    SimError
    └── CameraError (ValueError)         a parameter or an array is invalid; names it and the remedy
        └── UnknownWeatherError          the weather does not exist; lists the known ones
"""

from wrongturn_sim.errors import SimError


class CameraError(SimError, ValueError):
    """A parameter of the camera, or an array given to it, is invalid. The message names the remedy."""


class UnknownWeatherError(CameraError):
    """No weather has this name. The message lists the known ones."""
