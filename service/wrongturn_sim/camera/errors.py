"""What can go wrong with the camera.

::

    SimError
    └── CameraError (ValueError)         a parameter is not what a camera can have; names it and the remedy
        └── UnknownWeatherError          no such weather; names those that there are
"""

from wrongturn_sim.errors import SimError


class CameraError(SimError, ValueError):
    """A parameter of the camera, or an array given to it, is not what it can be; the message names the remedy."""


class UnknownWeatherError(CameraError):
    """There is no weather of this name; the message names those that there are."""
