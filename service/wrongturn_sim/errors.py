"""What can go wrong in the simulation.

::

    SimError
    ├── InvalidActionError (ValueError)      an action's field is missing, not finite or out of its range
    ├── EpisodeNotStartedError               a step before the first reset
    ├── EpisodeAlreadyFinishedError          a step after the end
    ├── TrafficTooDenseError (ValueError)    the trial has more road users than its town has room for
    ├── InvalidTrialError (ValueError)       a trial's field cannot be
    ├── TrialNotAloneError (ValueError)      egos of one batch drive alone, in one town
    ├── TrajectoryError (ValueError)         bytes that are no trajectory
    └── SimulatorError
        ├── SimulatorUnavailableError        libsumo cannot be loaded
        ├── SimulatorInUseError              another environment of this process took the simulator
        └── SimulatorFailedError             SUMO refused or died

``FaultNotApplicableError`` belongs to ``wrongturn_networks``, which checks trials when they are drawn.
"""


class SimError(Exception):
    """Anything that the simulation refuses."""


class InvalidActionError(SimError, ValueError):
    """An action's field is missing, not finite or out of its range; the message names the field and the range."""


class EpisodeNotStartedError(SimError):
    """A step before the first reset."""


class EpisodeAlreadyFinishedError(SimError):
    """A step after the end."""


class TrafficTooDenseError(SimError, ValueError):
    """The trial has more road users than its town has room for; the message names the field and the room."""


class InvalidTrialError(SimError, ValueError):
    """A trial's field cannot be; the message names it."""


class TrialNotAloneError(SimError, ValueError):
    """The trial has other road users, or is of another town; egos of one batch drive alone in one town."""


class TrajectoryError(SimError, ValueError):
    """Bytes that are no trajectory."""


class SimulatorError(SimError):
    """Anything that concerns SUMO."""


class SimulatorUnavailableError(SimulatorError):
    """The libsumo library cannot be loaded; the message names what is missing."""


class SimulatorInUseError(SimulatorError):
    """Another environment of this process took the simulator: there is one to a process."""


class SimulatorFailedError(SimulatorError):
    """SUMO refused a call or died."""
