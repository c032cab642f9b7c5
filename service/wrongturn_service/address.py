"""The address that the service listens on. It is bound before anything slow starts."""

import errno
import socket

_BACKLOG = 2048
_IDLE_S = 30
"""Seconds of silence before the kernel probes the peer."""
_PROBES = 3
"""Unanswered probes before the kernel closes the connection."""
_LAST_RESERVED = 1023
"""The highest port that only root may bind."""


class AddressError(Exception):
    """The address cannot be bound. The message names the option, and says why and what to do."""

    def __init__(self, option: str, reason: str, remedy: str | None = None) -> None:
        super().__init__(f"{option}: {reason}" if remedy is None else f"{option}: {reason}; {remedy}")
        self.reason = reason


def bind(host: str, port: int, patience_s: float = 30.0) -> socket.socket:
    """Bind an address and listen on it.

    ``patience_s`` is when the kernel drops a peer that reads nothing.

    Raises:
        AddressError: The address is in use, reserved, or belongs to another machine.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        bound = socket.socket(family, kind, protocol)
    except OSError as error:
        raise AddressError(f"--host {host}", error.strerror or str(error), "name an address of this machine") from error
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # The kernel closes connections whose peer has vanished. Accepted connections inherit this.
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (
            (socket.TCP_KEEPIDLE, _IDLE_S),
            (socket.TCP_KEEPINTVL, _IDLE_S // _PROBES),
            (socket.TCP_KEEPCNT, _PROBES),
            # Without this, unread bytes keep a connection for a quarter of an hour, even a closed one.
            (socket.TCP_USER_TIMEOUT, round(1000 * patience_s)),
        ):
            bound.setsockopt(socket.IPPROTO_TCP, option, value)
        bound.bind(address)
        bound.listen(_BACKLOG)
    except OSError as error:
        bound.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressError(
                f"--port {port}", f"is in use on {host}", "stop that program or name another port; 0 takes a free one"
            ) from error
        if error.errno == errno.EACCES and port <= _LAST_RESERVED:
            raise AddressError(
                f"--port {port}",
                "only root may listen on it",
                f"name a port above {_LAST_RESERVED}, such as --port 8000",
            ) from error
        raise AddressError(f"--host {host} --port {port}", error.strerror or str(error)) from error
    return bound
