"""Statistics of tables and figures."""

from typing import Any

from wrongturn_agents.errors import MissingPackageError


def scipy_stats() -> Any:
    """Import and return ``scipy.stats``, which takes a second.

    Raises:
        MissingPackageError: scipy is not installed.
    """
    try:
        import scipy.stats  # noqa: PLC0415 - takes a second to import
    except ImportError as error:
        raise MissingPackageError("scipy is not installed; install wrongturn-agents[figures]") from error
    return scipy.stats
