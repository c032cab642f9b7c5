"""The address that the service listens on, taken before anything heavy is begun."""

import errno
import socket

_BACKLOG = 2048
_LAST_RESERVED = 1023
"""The greatest port for which an ordinary user has no rights."""


class AddressError(Exception):
    """The address cannot be listened on; the message says why and what to do."""


def bind(host: str, port: int) -> socket.socket:
    """A listening address, taken before anything else is begun.

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
