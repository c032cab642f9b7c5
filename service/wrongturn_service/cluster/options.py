"""What the settings about Ray may be."""

import ssl
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from wrongturn_protocol.installing import install

RAY: Final = "ray"
MOST: Final = 4096
"""Most simulators of one service."""
_MOST_ON_RAY: Final = 1024
"""Most simulators on Ray if no number is given."""
_LAST_PORT: Final = 65535


def simulators(given: int | str) -> int | str:
    """Return a number of simulators, or ``ray`` with or without one. Raises ValueError for anything else."""
    where, colon, number = str(given).rpartition(":") if str(given) != RAY else (RAY, "", "1")
    count = int(number) if number.isdecimal() else 0
    if where not in {"", RAY} or (colon and not where) or not 1 <= count <= MOST:
        raise ValueError(f"is {str(given)!r}; give a number from 1 to {MOST}, 'ray', or 'ray:' and a number")
    if not where:
        return count
    require_ray()
    return given


def require_ray() -> None:
    """Raise ValueError if Ray is not installed."""
    if find_spec("ray") is None:
        raise ValueError(f"needs Ray, which is not installed; {install('wrongturn-service[ray]')}")


def most(simulators: int | str) -> int:
    """Return the largest number of simulators that a checked setting allows."""
    return simulators if isinstance(simulators, int) else int(simulators.partition(":")[2] or _MOST_ON_RAY)


def host_and_port(address: str, port: int | None = None) -> tuple[str, int]:
    """Return the two parts of an address; ``port`` is for one without. Raises ValueError."""
    host, colon, digits = address.rpartition(":")
    if port is not None and (not colon or (":" in host and not host.endswith("]"))):
        host, digits = address, str(port)
    bare = host.removeprefix("[").removesuffix("]")
    if (
        not bare
        or (":" in bare and host == bare and port is None)
        or not digits.isdecimal()
        or int(digits) > _LAST_PORT
    ):
        raise ValueError(f"is {address!r}; give an address and a port like 10.0.0.1:8001 or [::1]:8001")
    return bare, int(digits)


def server_tls(certificate: Path, key: Path | None) -> ssl.SSLContext:
    """Return what a server with a certificate needs. Raises ValueError if the files are not such a pair."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:  # ssl.SSLError is one
        raise ValueError(f"{certificate} and {key} are no certificate and its key in PEM ({error})") from None
    return context
