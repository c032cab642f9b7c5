"""The suites that results are of, from the networks where they are installed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from wrongturn_agents.reporting.errors import ResultsError
from wrongturn_client.plugins import entry_points, load
from wrongturn_protocol import Trial

WRONG_COMMAND: Final = "wrong-command@1"
NAVIGATION: Final = "navigation@1"
_GROUP: Final = "wrongturn.suites"


@dataclass(frozen=True)
class SuiteTrials:
    """What a results file is held against."""

    id: str
    sha256: str
    trials: Mapping[str, Trial]
    """All that an evaluation drives, twins too, by id."""


SuiteOf = Callable[[str], SuiteTrials]
"""Finds a suite by its id."""


@lru_cache(maxsize=16)
def installed_suite(suite: str) -> SuiteTrials:
    """The suite of this id, as it is installed here.

    Raises:
        ResultsError: there is none, and those that there are are named; or no networks are installed.
    """
    point = entry_points(_GROUP).get("shipped")
    if point is None:
        raise ResultsError("no suites are installed here; install wrongturn-networks (again)")
    try:
        found = load(point)(suite)
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return SuiteTrials(found.id, found.sha256, {trial.id: trial for trial in found.episodes})
