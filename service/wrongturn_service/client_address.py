"""The client's address, as limits and quotas count it."""

from functools import lru_cache
from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network
from typing import Final

import structlog
from starlette.requests import HTTPConnection

UNKNOWN: Final = "unknown"
"""Stands for every address that is none."""
_SITE_BITS: Final = 64
"""Bits of an IPv6 address that name a site. One machine has all addresses behind them."""


def address_of(connection: HTTPConnection) -> str:
    """Return the client's address, or the one that a trusted proxy reports, see :func:`counted`."""
    host = connection.client.host if connection.client is not None else UNKNOWN
    forwarded = connection.headers.get("x-forwarded-for")
    if forwarded is not None and host not in forwarded:
        _check_proxy(host)
    return counted(host)


@lru_cache(maxsize=4096)
def counted(host: str) -> str:
    """Return an address in the form by which it is counted.

    IPv4 stays as it is, also inside IPv6 (``::ffff:192.0.2.1``). IPv6 is counted by its /64, for example
    ``2001:db8::/64``. What is no address is :data:`UNKNOWN`.
    """
    address = parsed(host)
    if address is None:
        return UNKNOWN
    if isinstance(address, IPv6Address) and not address.is_loopback:
        return str(ip_network((int(address), _SITE_BITS), strict=False))
    return str(address)


def parsed(host: str) -> IPv4Address | IPv6Address | None:
    """Return an address without its zone, and IPv4 out of IPv6; None for what is no address."""
    try:
        address = ip_address(host.partition("%")[0])
    except ValueError:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def _check_proxy(host: str) -> None:
    """Log that a neighbour's ``X-Forwarded-For`` is not believed, since all its clients then share one limit."""
    address = parsed(host)
    if address is not None and not address.is_global:
        _warn(host)


@lru_cache(maxsize=1)
def _warn(host: str) -> None:
    structlog.get_logger("limits").warning(
        "X-Forwarded-For is not believed, so all clients of this proxy count as one address",
        proxy=host,
        remedy="name the proxy in WRONGTURN_TRUSTED_PROXIES",
    )
