"""The settings about Ray: variables ``WRONGTURN_RAY_*`` of a service whose simulators or runners are on a cluster."""

import ssl
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, ValidationInfo, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from wrongturn_service.settings import PREFIX

_LAST_PORT: Final = 65535


class RaySettings(BaseSettings):
    """The settings. ``python lab/settings_page.py`` writes their docstrings into ``docs/settings.md``."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, frozen=True, extra="forbid", use_attribute_docstrings=True, env_ignore_empty=True
    )

    ray_address: Annotated[str, Field(min_length=1)] = "auto"
    """Address of the Ray cluster, such as `10.0.0.1:6379`. `auto` is the one that runs on this machine. This machine
    has to be a node of it, see `WRONGTURN_RAY_JOIN`."""
    ray_join: bool = False
    """Whether the service makes its own machine or container a node of the cluster, one without cores."""
    ray_listen: str = "0.0.0.0:8001"
    """Address and port at which programs on Ray's nodes connect with the service. Port 0 takes a free one."""
    ray_advertise: str = ""
    """Address at which the nodes reach that one, if it is another; a port may follow. Default: the address that Ray has
    for this machine."""
    ray_certificate: Path | None = None
    """PEM file of a certificate, also a self-signed one. With it the programs connect by TLS, and accept no other."""
    ray_key: Path | None = Field(default=None, validate_default=True)
    """PEM file of the certificate's key."""

    @field_validator("ray_listen")
    @classmethod
    def _with_port(cls, address: str) -> str:
        host_and_port(address)
        return address

    @field_validator("ray_advertise")
    @classmethod
    def _maybe_with_port(cls, address: str) -> str:
        host_and_port(address or "0.0.0.0", port=0)  # noqa: S104 - empty means none
        return address

    @field_validator("ray_key")
    @classmethod
    def _pair(cls, key: Path | None, info: ValidationInfo) -> Path | None:
        certificate = info.data.get("ray_certificate")
        if (certificate is None) != (key is None):
            missing = PREFIX + ("RAY_CERTIFICATE" if certificate is None else "RAY_KEY")
            raise ValueError(f"{missing} is not set; set both files, or neither")
        if certificate is not None:
            server_tls(certificate, key)
        return key


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
