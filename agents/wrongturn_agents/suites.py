"""The suites that are installed here, as runs and reports need them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from wrongturn_agents.errors import ResultsError
from wrongturn_client.plugins import LOADERS, entry_points, load
from wrongturn_protocol import Trial
from wrongturn_protocol.installing import install

UNSEEN: Final = "wrong-command-unseen@1"
"""The ranking that counts: towns that nobody has seen."""
WRONG_COMMAND: Final = "wrong-command@3"
"""The paper's table: Town01."""
NAVIGATION: Final = "navigation@1"


@dataclass(frozen=True)
class SuiteTrials:
    """The trials of a suite, or of one draw of its cells, with the hash that identifies the suite's version."""

    id: str
    sha256: str
    trials: Mapping[str, Trial]
    """Every trial that an evaluation drives, twins included, by id."""
    secret: str | None = None
    """The secret of the draw; None for a suite that lists its trials."""
    commitment: str | None = None
    """SHA-256 of the secret's text; None for a suite that lists its trials."""

    @property
    def crowded(self) -> set[str]:
        """Ids of the trials with other road users."""
        return {name for name, trial in self.trials.items() if trial.traffic.vehicles or trial.traffic.pedestrians}


@lru_cache(maxsize=128)
def installed_suite(suite: str, secret: str | None = None) -> SuiteTrials:
    """Return the trials of the installed suite with this id, in the draw of a secret; None for the open draw.

    Towns that the secret makes are built where they are missing, which takes some seconds. Raises as
    :func:`sha256_of_suite`.
    """
    found = _loaded(suite)
    draw = found.open_draw if secret is None else found.draw(secret)
    trials = {trial.id: trial for trial in draw.episodes}
    return SuiteTrials(found.id, found.sha256, trials, draw.secret, draw.commitment)


def suite_named(text: str) -> str:
    """Return the id of the suite that a user names by its id or its file. A file is then known by its id here.

    Raises as :func:`sha256_of_suite`, for files alone.
    """
    return str(_loaded(text).id) if text.endswith(".json") else text


def sha256_of_suite(suite: str) -> str:
    """Return the hash of the installed suite with this id.

    Raises:
        ResultsError: No suite has this id (the error lists those that exist), or wrongturn-networks is not installed.
    """
    return str(_loaded(suite).sha256)


def _loaded(suite: str) -> Any:
    point = entry_points(LOADERS).get("suite")
    if point is None:
        raise ResultsError(
            f"no suites are installed here; {install('wrongturn-networks')}. To run agents without a --url: "
            f"{install('wrongturn-networks', 'wrongturn-service[server]')}"
        )
    try:
        return load(point)(suite)
    except ValueError as error:
        raise ResultsError(str(error)) from error
