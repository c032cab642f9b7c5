"""Statistics of tables and figures."""

from functools import lru_cache
from typing import Any, Final

from wrongturn_agents.errors import MissingPackageError

_LEVEL: Final = 0.95


@lru_cache(maxsize=4096)
def wilson(count: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of the rate ``count / trials``.

    Raises:
        MissingPackageError: scipy is not installed.
    """
    interval = scipy_stats().binomtest(count, trials).proportion_ci(_LEVEL, method="wilson")
    return float(interval.low), float(interval.high)


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
