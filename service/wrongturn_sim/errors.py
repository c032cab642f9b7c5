"""Errors of the simulation.

::

    SimError
    ├── InvalidActionError (ValueError)      a field of the action is missing, not finite or out of range
    ├── EpisodeNotStartedError               a step before the first reset
    ├── EpisodeAlreadyFinishedError          a step after the end
    ├── TrafficTooDenseError (ValueError)    the trial has more road users than its town has room for
    ├── InvalidTrialError (ValueError)       a field of the trial is invalid
    ├── TrialNotAloneError (ValueError)      the cars of one batch drive alone, in one town
    ├── DependencyMissingError (ImportError) an optional package is missing
    ├── CameraError (ValueError)             a parameter of the camera or an array is invalid
    │   └── UnknownWeatherError              no weather has this name
    ├── ViewError (ValueError)               a picture or film cannot be made as asked
    │   └── FilmError                        the film's file
    └── SimulatorError
        ├── SimulatorUnavailableError        libsumo cannot be loaded
        ├── SimulatorInUseError              another episode of this process took the simulator
        └── SimulatorFailedError             SUMO refused or died

``FaultNotApplicableError`` belongs to ``wrongturn_networks``, ``TrajectoryError`` to ``wrongturn_judge``.
"""


class SimError(Exception):
    """Base class of the simulation's errors."""


class InvalidActionError(SimError, ValueError):
    """A field of the action is missing, not finite or out of range; the message names the field and the range."""


class EpisodeNotStartedError(SimError):
    """A step before the first reset."""


class EpisodeAlreadyFinishedError(SimError):
    """A step after the end."""


class TrafficTooDenseError(SimError, ValueError):
    """The trial has more road users than its town has room for; the message names the field and the limit."""


class InvalidTrialError(SimError, ValueError):
    """A field of the trial is invalid; the message names it."""


class TrialNotAloneError(SimError, ValueError):
    """The trial has other road users or another town; the cars of one batch drive alone in one town."""


class DependencyMissingError(SimError, ImportError):
    """An optional package is missing; the message names the command that installs it."""


class CameraError(SimError, ValueError):
    """A parameter of the camera, or an array given to it, is invalid. The message names the remedy."""


class UnknownWeatherError(CameraError):
    """No weather has this name. The message lists the known ones."""


class ViewError(SimError, ValueError):
    """A picture or film cannot be made as asked. The message names the remedy."""


class FilmError(ViewError):
    """A film's file cannot be written, or its name ends wrongly."""


class SimulatorError(SimError):
    """Base class of the errors that come from SUMO."""


class SimulatorUnavailableError(SimulatorError):
    """The libsumo library cannot be loaded; the message names what is missing."""


class SimulatorInUseError(SimulatorError):
    """Another episode of this process took the simulator; each process has only one."""


class SimulatorFailedError(SimulatorError):
    """SUMO refused a call or died."""
