"""File descriptors: how many the service may have, and which of them are for connections.

Without any left, the event loop would close new connections without a word, and the database and the simulators could
open nothing. So the last ones are not for connections.
"""

import resource
from typing import Final

import structlog

_OWN: Final = 64
"""Descriptors of the database, the log, uploads and submissions."""
_PER_SIMULATOR: Final = 4
_LARGEST_SHARE: Final = 0.5
"""The descriptors that are not for connections are at most this share of all."""


def raise_limit() -> int:
    """Raise the soft limit of this process to the hard one, and return it."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    return hard


def for_connections(limit: int, simulators: int) -> int:
    """Return how many descriptors the service may have when it takes another connection.

    Args:
        limit: Descriptors that the process may have.
        simulators: Largest number of simulators that drive.
    """
    return limit - min(_OWN + _PER_SIMULATOR * simulators, int(limit * _LARGEST_SHARE))


def warn_if_few(limit: int, simulators: int, connections: int) -> None:
    """Log a warning if the process may not have the descriptors for so many connections."""
    there = for_connections(limit, simulators)
    if there < connections:
        structlog.get_logger("server").warning(
            "few file descriptors",
            limit=limit,
            connections=there,
            remedy=f"raise the hard limit (ulimit -Hn, LimitNOFILE=) to {connections + limit - there}, "
            f"or set WRONGTURN_MAX_CONNECTIONS to {there}",
        )
