"""How a program on a node connects with the service: by TCP, with the secret of its start, under TLS if it is asked to.

The service gives a program what it needs in its environment, see :func:`way`.
"""

import os
import platform
import socket
import ssl
from collections.abc import Mapping
from typing import Final

SECRET: Final = "WRONGTURN_CONNECT_SECRET"  # noqa: S105 - a variable's name
CERTIFICATE: Final = "WRONGTURN_CONNECT_CERTIFICATE"
_CONNECT_S: Final = 20.0
_IDLE_S, _AGAIN_S, _PROBES = 3, 1, 5
_UNHEARD_MS: Final = 8000
"""Milliseconds after which data that nobody acknowledges ends a connection."""


class CertificateError(Exception):
    """Another machine than the service answered."""


def keep_watch(stream: socket.socket) -> None:
    """Set a connection up so that each write leaves at once, and a machine that vanishes is noticed within seconds."""
    for level, option, value in (
        (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _IDLE_S),
        (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _AGAIN_S),
        (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _PROBES),
        (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNHEARD_MS),
    ):
        stream.setsockopt(level, option, value)


def way(secret: str, certificate: str | None) -> dict[str, str]:
    """Return the variables that let a program connect; ``certificate`` is the service's in PEM, None without TLS."""
    return {SECRET: secret, **({CERTIFICATE: certificate} if certificate is not None else {})}


def connect(address: str, environment: Mapping[str, str] = os.environ) -> socket.socket:
    """Connect with the service that listens at ``HOST:PORT``, and say by the secret which program this is.

    Raises:
        OSError: Nobody answers there.
        CertificateError: Who answers has not the certificate that the environment has.
    """
    host, _, port = address.rpartition(":")
    stream = socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S)
    keep_watch(stream)
    if CERTIFICATE in environment:
        # This certificate and no other, so it does not matter who has signed it or what it names.
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        stream = context.wrap_socket(stream)
        if stream.getpeercert(binary_form=True) != ssl.PEM_cert_to_DER_cert(environment[CERTIFICATE]):
            stream.close()
            raise CertificateError(f"{address} has another certificate than the service")
    stream.sendall(f"{environment[SECRET]} pid {os.getpid()} on {platform.node()}\n".encode())
    stream.settimeout(None)
    return stream
