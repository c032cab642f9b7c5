"""The suites that are installed here, as runs and reports need them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from wrongturn_agents.errors import ResultsError
from wrongturn_client.plugins import entry_points, load
from wrongturn_protocol import Trial

WRONG_COMMAND: Final = "wrong-command@1"
NAVIGATION: Final = "navigation@1"


@dataclass(frozen=True)
class SuiteTrials:
    """A suite's trials, with the hash that identifies its version."""

    id: str
    sha256: str
    trials: Mapping[str, Trial]
    """Every trial that an evaluation drives, twins included, by id."""

    @property
    def crowded(self) -> set[str]:
        """Ids of the trials with other road users."""
        return {name for name, trial in self.trials.items() if trial.traffic.vehicles or trial.traffic.pedestrians}


@lru_cache(maxsize=16)
def installed_suite(suite: str) -> SuiteTrials:
    """Return the installed suite with this id.

    Raises:
        ResultsError: No suite has this id (the error lists those that exist), or wrongturn-networks is not installed.
    """
    point = entry_points("wrongturn.suites").get("shipped")
    if point is None:
        raise ResultsError("no suites are installed here; install wrongturn-networks (again)")
    try:
        found = load(point)(suite)
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return SuiteTrials(found.id, found.sha256, {trial.id: trial for trial in found.episodes})
