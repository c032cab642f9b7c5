"""Errors about towns, suites and trials.

NetworkError
├── UnknownTownError
├── TownBuildError
├── ImportTownError
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
from typing import ClassVar

from wrongturn_protocol.suggestions import did_you_mean


class NetworkError(ValueError):
    """Base class of this package's errors; the message names the field and the remedy."""


class UnknownNameError(NetworkError):
    """An unknown name. The message lists the known ones, and the one that may be meant."""

    what: ClassVar[str]
    """What has the name, such as ``town``: each subclass says it."""

    def __init_subclass__(cls, what: str) -> None:
        cls.what = what

    def __init__(self, name: str, known: Iterable[str], field: str | None = None) -> None:
        self.name = name
        self.known = tuple(known)
        shown = ", ".join(self.known[:40]) + (" …" if len(self.known) > 40 else "")
        meant = did_you_mean(name, self.known)
        super().__init__(f"{field or self.what}: {name!r} is not known; there are: {shown or 'none'}{meant}")


class UnknownTownError(UnknownNameError, what="town"):
    """No town has this name."""


class TownBuildError(NetworkError):
    """A drawn town cannot be built: SUMO's netconvert is missing, or a folder cannot be written."""


class ImportTownError(NetworkError):
    """A file cannot become a town; the message says why."""


class UnknownApproachError(UnknownNameError, what="approach"):
    """The town has no such approach."""


class UnknownLaneError(UnknownNameError, what="lane"):
    """The town has no such car lane."""


class UnknownSuiteError(UnknownNameError, what="suite"):
    """No suite has this name and version."""


class UnknownTrialError(UnknownNameError, what="trial"):
    """The suite has no such trial."""


class FaultNotApplicableError(NetworkError):
    """The fault is not installed, or cannot be applied, such as ``infeasible`` where all directions exist."""


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
