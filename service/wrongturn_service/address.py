"""The address that the service listens on, taken before anything heavy is begun."""

import errno
import socket
import sys

_BACKLOG = 2048
_IDLE_S = 30
"""Seconds of silence after which the kernel asks whether the peer is still there."""
_PROBES = 3
"""Unanswered questions after which it is not."""
_LAST_RESERVED = 1023
"""The greatest port for which an ordinary user has no rights."""


class AddressError(Exception):
    """The address cannot be listened on; the message says why and what to do."""


def bind(host: str, port: int, patience_s: float = 30.0) -> socket.socket:
    """A listening address, taken before anything else is begun.

    Args:
        host: its name or number.
        port: 0 for a free one.
        patience_s: seconds after which a peer that takes nothing that is sent to it counts as gone.

    Raises:
        AddressError: it is in use, reserved, or not this machine's.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host,
            port,
            type=socket.SOCK_STREAM,
            flags=socket.AI_PASSIVE,
        )[0]
        bound = socket.socket(family, kind, protocol)
    except OSError as error:
        raise AddressError(f"--host {host}: {error.strerror or error}; name an address of this machine") from error
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _notice_the_dead(bound, patience_s)
        bound.bind(address)
        bound.listen(_BACKLOG)
    except OSError as error:
        bound.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressError(
                f"--port {port}: is in use on {host}; stop who has it, name another, or take a free one by --port 0",
            ) from error
        if error.errno == errno.EACCES and port <= _LAST_RESERVED:
            raise AddressError(
                f"--port {port}: only root may listen on it; name a port above {_LAST_RESERVED}, such as --port 8000",
            ) from error
        raise AddressError(f"--host {host} --port {port}: {error.strerror or error}") from error
    return bound


def _notice_the_dead(listening: socket.socket, patience_s: float) -> None:
    """Let the kernel end connections whose peer is gone without a word; those that are accepted inherit it."""
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if sys.platform == "linux":
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _IDLE_S)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _IDLE_S // _PROBES)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _PROBES)
        # What is sent and not taken keeps a connection for a quarter of an hour otherwise, closed or not.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * patience_s))
