"""What can be wrong with a name or a request about towns and suites.

NetworkError
├── UnknownTownError
├── UnknownApproachError
├── UnknownLaneError
├── UnknownSuiteError
├── UnknownTrialError
├── FaultNotApplicableError
├── RouteNotAvailableError
├── ApproachTooShortError
├── NoJourneyError
├── CruiseError
└── CorruptFileError
"""

from collections.abc import Iterable


class NetworkError(ValueError):
    """The root of this package's errors; the message names the field and the remedy."""


class _UnknownNameError(NetworkError):
    """A name that nothing has; the message lists the names that there are."""

    what = "name"

    def __init__(self, name: str, known: Iterable[str]) -> None:
        self.name = name
        self.known = tuple(known)
        shown = ", ".join(self.known[:40]) + (" …" if len(self.known) > 40 else "")
        super().__init__(f"{self.what}: {name!r} is not known; there are: {shown or 'none'}")


class UnknownTownError(_UnknownNameError):
    """No town has this name."""

    what = "town"


class UnknownApproachError(_UnknownNameError):
    """The town has no such approach."""

    what = "approach"


class UnknownLaneError(_UnknownNameError):
    """The town has no such car lane."""

    what = "lane"


class UnknownSuiteError(_UnknownNameError):
    """No suite has this name and version."""

    what = "suite"


class UnknownTrialError(_UnknownNameError):
    """The suite has no such trial."""

    what = "trial"


class FaultNotApplicableError(NetworkError):
    """The fault cannot be done here, such as an infeasible command where all directions exist."""


class RouteNotAvailableError(NetworkError):
    """The route asks for an exit that the approach does not have."""


class ApproachTooShortError(NetworkError):
    """The approach's lane is too short to start on."""


class NoJourneyError(NetworkError):
    """The town has no journey of the task there."""


class CruiseError(NetworkError):
    """What a cruise is to be drawn by makes no sense, such as shares of more than all starts."""


class CorruptFileError(NetworkError):
    """A town's or a suite's file is not what its checksum says."""
