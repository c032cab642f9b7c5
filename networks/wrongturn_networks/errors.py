"""Errors about towns, suites and trials.

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
├── SecretError
├── CommitmentError
└── CorruptFileError
"""

from collections.abc import Iterable

from wrongturn_protocol.suggestions import did_you_mean


class NetworkError(ValueError):
    """Base class of this package's errors; the message names the field and the remedy."""


class UnknownNameError(NetworkError):
    """An unknown name. The message lists the known ones, and the one that may be meant."""

    what = "name"

    def __init__(self, name: str, known: Iterable[str], field: str | None = None) -> None:
        self.name = name
        self.known = tuple(known)
        shown = ", ".join(self.known[:40]) + (" …" if len(self.known) > 40 else "")
        meant = did_you_mean(name, self.known)
        super().__init__(f"{field or self.what}: {name!r} is not known; there are: {shown or 'none'}{meant}")


class UnknownTownError(UnknownNameError):
    """No town has this name."""

    what = "town"


class UnknownApproachError(UnknownNameError):
    """The town has no such approach."""

    what = "approach"


class UnknownLaneError(UnknownNameError):
    """The town has no such car lane."""

    what = "lane"


class UnknownSuiteError(UnknownNameError):
    """No suite has this name and version."""

    what = "suite"


class UnknownTrialError(UnknownNameError):
    """The suite has no such trial."""

    what = "trial"


class FaultNotApplicableError(NetworkError):
    """The fault is not built yet, or cannot be applied, such as ``infeasible`` where all directions exist."""


class RouteNotAvailableError(NetworkError):
    """The route asks for an exit that the approach does not have."""


class ApproachTooShortError(NetworkError):
    """The approach's lane is too short for a start."""


class NoJourneyError(NetworkError):
    """The town has no such journey, or none from that approach."""


class CruiseError(NetworkError):
    """An argument of a cruise is out of range, such as shares of the starts that add up to more than 1."""


class SecretError(NetworkError):
    """The secret of a draw is missing, empty or not text in UTF-8, or the suite draws nothing."""


class CommitmentError(NetworkError):
    """The secret's SHA-256 is not what the evaluation told at its beginning."""


class CorruptFileError(NetworkError):
    """A file of a town or suite does not match its checksum."""
