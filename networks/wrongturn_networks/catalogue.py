"""Lists of suites and towns for the command line, without a service."""

from collections.abc import Iterator, Mapping

from wrongturn_networks import loading, suites
from wrongturn_networks.drawn import SUMO
from wrongturn_networks.errors import NetworkError
from wrongturn_networks.faults import left_out_faults
from wrongturn_networks.loading import load_town, town_named, town_names
from wrongturn_networks.suites import Suite, load_suite, suite_ids, suite_named
from wrongturn_networks.town import Town
from wrongturn_protocol import SuiteSummary, TownSummary
from wrongturn_protocol.installing import install


def list_suites() -> list[SuiteSummary]:
    """Return all suites."""
    return [load_suite(suite_id).summary() for suite_id in suite_ids()]


def list_towns() -> list[TownSummary]:
    """Return all towns."""
    return [load_town(name).summary() for name in town_names()]


def find_town(text: str) -> Town:
    """Return the town that a user names, by its name or its folder. Raises NetworkError."""
    return load_town(town_named(text))


def find_suite(text: str) -> Suite:
    """Return the suite that a user names, by its id or its file. Raises NetworkError."""
    return load_suite(suite_named(text))


def checks() -> Iterator[tuple[str, bool, str, str]]:
    """Yield the checks of ``wrongturn doctor``: name, whether it passed, what was found, the remedy."""
    remedy = install("wrongturn-networks")
    for what, listed, shelf in (("suites", list_suites, suites.shelf()), ("towns", list_towns, loading.shelf())):
        try:
            found = listed()
        except (NetworkError, OSError) as error:
            yield what, False, str(error), remedy
        else:
            yield what, bool(found), f"{len(found)} found, checksums right", remedy
        yield from _left_out(what, shelf.left_out)
    yield from _left_out("faults", left_out_faults())
    yield _netconvert()


def _netconvert() -> tuple[str, bool, str, str]:
    from wrongturn_networks.making.netconvert import version  # noqa: PLC0415 - lists of towns do not need it

    remedy = install(f"eclipse-sumo=={SUMO}")
    try:
        found = version()
    except (RuntimeError, OSError) as error:
        return "netconvert", False, str(error), remedy
    return "netconvert", found == SUMO, f"{found}; it builds drawn towns", remedy


def _left_out(what: str, reasons: Mapping[str, str]) -> Iterator[tuple[str, bool, str, str]]:
    for label, reason in reasons.items():
        yield what, False, f"{label} is left out: {reason}", "repair or remove its package"
