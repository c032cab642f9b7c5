"""Lists of suites and towns for the command line, without a service."""

from collections.abc import Iterator

from wrongturn_networks.errors import NetworkError
from wrongturn_networks.loading import load_town, town_names
from wrongturn_networks.suites import load_suite, suite_ids
from wrongturn_protocol import SuiteSummary, TownSummary


def list_suites() -> list[SuiteSummary]:
    """Return all suites."""
    return [load_suite(suite_id).summary() for suite_id in suite_ids()]


def list_towns() -> list[TownSummary]:
    """Return all towns."""
    return [load_town(name).summary() for name in town_names()]


def checks() -> Iterator[tuple[str, bool, str, str]]:
    """Yield the checks of ``wrongturn doctor``: name, whether it passed, what was found, the remedy."""
    for what, listed in (("suites", list_suites), ("towns", list_towns)):
        try:
            found = listed()
        except (NetworkError, OSError) as error:
            yield what, False, str(error), "install wrongturn-networks again"
        else:
            yield what, bool(found), f"{len(found)} found, checksums right", "install wrongturn-networks again"
