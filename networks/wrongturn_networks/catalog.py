"""What there is without a service: the lists behind ``wrongturn suites`` and ``wrongturn towns``."""

from collections.abc import Iterator

from wrongturn_networks.errors import NetworkError
from wrongturn_networks.loading import load_town, town_names
from wrongturn_networks.suites import load_suite, suite_ids
from wrongturn_protocol import SuiteSummary, TownSummary


def list_suites() -> list[SuiteSummary]:
    """All suites."""
    return [load_suite(suite_id).summary() for suite_id in suite_ids()]


def list_towns() -> list[TownSummary]:
    """All towns."""
    return [load_town(name).summary() for name in town_names()]


def checks() -> Iterator[tuple[str, bool, str, str]]:
    """What ``wrongturn doctor`` looks at: name, whether it is well, what was seen, the remedy."""
    for what, listed in (("suites", list_suites), ("towns", list_towns)):
        try:
            found = listed()
        except (NetworkError, OSError) as error:
            yield what, False, str(error), "install wrongturn-networks again"
        else:
            yield what, bool(found), f"{len(found)} found, checksums right", "install wrongturn-networks again"
