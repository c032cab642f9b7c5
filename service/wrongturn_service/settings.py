"""The service's settings: ``WRONGTURN_*`` variables or options of ``serve``."""

from enum import StrEnum
from functools import cached_property
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import platformdirs
from pydantic import Field, SecretStr, ValidationInfo, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from wrongturn_service.machine import Machine
from wrongturn_service.secret_file import Secret, read_secret

PREFIX = "WRONGTURN_"
GATEWAY = "gateway"
"""Stands for the address of the default gateway."""
Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Registration(StrEnum):
    """Who may register agents."""

    OPEN = "open"
    OPERATOR = "operator"


class Settings(BaseSettings):
    """The service's settings, described in ``docs/settings.md``."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX,
        frozen=True,
        extra="forbid",
        use_attribute_docstrings=True,
        env_ignore_empty=True,
    )

    host: str = "127.0.0.1"
    """Address to listen on."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on. 0 takes a free port."""
    public_url: str | None = None
    """URL at which people reach the service behind a proxy. Default: the one of each request."""
    home: Path = Field(default_factory=lambda: Path(platformdirs.user_data_dir("wrongturn")))
    """Folder for data, models, your towns and caches."""
    database: str = ""
    """SQLAlchemy URL of the database. Default: the SQLite file ``wrongturn.db`` in the home."""
    database_password_file: Path | None = None
    """File with the password of a PostgreSQL database whose URL has none."""
    operator_token: SecretStr | None = None
    """The operator's bearer token. Without it there is no operator."""
    operator_token_file: Path | None = None
    """File with the operator's token, in place of ``operator_token``. It is read at each use."""
    registration: Registration = Registration.OPEN
    """``open``: everybody may register owners and agents. ``operator``: only the operator registers owners.

    Owners always register their agents by their token."""
    registration_limit: Annotated[int, Field(ge=1)] = 100
    """Owners and agents that one address may register within an hour. The operator is exempt, and so are agents that
    register with their owner's token."""
    agents_per_owner: Annotated[int, Field(ge=1)] = 100
    """Agents of one owner. The owner of the shipped agents is exempt."""
    accounts_per_address: Annotated[int, Field(ge=2)] = 1000
    """Owners and agents that one address may have registered in all."""
    bytes_per_owner: Annotated[int, Field(ge=1 << 20)] = 1 << 30
    """Bytes that may be stored for one owner. The owner of the shipped agents is exempt."""
    bytes_per_address: Annotated[int, Field(ge=1 << 20)] = 4 << 30
    """Bytes that may be stored for all owners that one address has registered."""
    metrics_token: SecretStr | None = None
    """Bearer token for ``GET /metrics``, beside the operator's. Without both only this machine may read the metrics."""
    metrics_token_file: Path | None = None
    """File with the token of the metrics, in place of ``metrics_token``. It is read at each use."""
    metrics_port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Port of its own for ``/metrics``, which the main port then does not have."""
    simulators: Annotated[int, Field(ge=1, le=4096)] = Field(
        default_factory=lambda: Machine().simulators(),
    )
    """Largest number of simulators that drive. Each is a process that starts when first needed and stays."""
    spare_simulators: Annotated[int, Field(ge=0, le=64)] = 1
    """Simulators kept ready beyond those that drive, to replace one that dies at once."""
    simulator_start_timeout_s: Seconds = 180.0
    """Seconds in which a simulator process must be ready. The first on a machine compiles its kernels."""
    simulator_timeout_s: Seconds = 30.0
    """Seconds after which a simulator that does not answer counts as dead.

    A step has at most 5. A replay has 0.02 more for each step."""
    lease_release_s: Seconds = 10.0
    """Seconds of an agent's silence after which its simulator is released."""
    lease_abort_s: Seconds = 600.0
    """Seconds of an agent's silence after which its episode is ``aborted``."""
    max_parallel: Annotated[int, Field(ge=1)] | None = None
    """Open episodes of one evaluation. Default: ``simulators``."""
    max_practice: Annotated[int, Field(ge=1)] | None = None
    """Open practice episodes of one agent. Default: twice ``simulators``."""
    max_open: Annotated[int, Field(ge=1)] | None = None
    """Open episodes of one agent, scored and practice. Default: four times ``simulators``."""
    max_open_per_owner: Annotated[int, Field(ge=1)] | None = None
    """Open episodes of one owner, scored and practice. Default: eight times ``simulators``."""
    max_practice_per_owner: Annotated[int, Field(ge=1)] | None = None
    """Open practice episodes of one owner. Default: four times ``simulators``."""
    max_open_per_address: Annotated[int, Field(ge=1)] | None = None
    """Open episodes that one address has begun, scored and practice. Default: sixteen times ``simulators``."""
    max_practice_per_address: Annotated[int, Field(ge=1)] | None = None
    """Open practice episodes that one address has begun. Default: eight times ``simulators``."""
    evaluation_idle_h: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 24.0
    """Hours without a reset or a step after which a running evaluation is closed, as DELETE closes it."""
    evaluation_days: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 7.0
    """Days that a driven evaluation may take. Then it is closed, however active its agent is."""
    max_waiting: Annotated[int, Field(ge=1)] = 64
    """Calls of one agent that may wait for a simulator."""
    max_line: Annotated[int, Field(ge=1)] = 1024
    """Calls of all agents that may wait for a simulator."""
    max_sockets: Annotated[int, Field(ge=1)] = 32
    """Connections to ``/v1/drive`` of one agent."""
    max_sockets_per_address: Annotated[int, Field(ge=1)] = 256
    """Connections to ``/v1/drive`` from one address."""
    max_connections: Annotated[int, Field(ge=1)] = 4096
    """Connections of all clients."""
    slow_client_s: Seconds = 30.0
    """Seconds in which a request, or its next 64 KiB, has to arrive, and a reply has to be read."""
    ping_interval_s: Seconds = 20.0
    """Seconds between two pings on a connection to ``/v1/drive``."""
    ping_timeout_s: Seconds = 60.0
    """Seconds after which a client that does not answer a ping counts as gone. An agent may think for that long."""
    trusted_proxies: str = ""
    """Proxies whose ``X-Forwarded-For`` is believed: addresses and networks, separated by commas, or ``*``.

    ``gateway`` is the address of the default gateway, which in a container is its machine. Default: nobody's."""
    submissions: Annotated[int, Field(ge=0, le=256)] = Field(
        default_factory=lambda: max(1, Machine().processors() // 2)
    )
    """Submissions driven at a time. 0 refuses them all."""
    submissions_per_owner: Annotated[int, Field(ge=1)] = 8
    """Submissions of one owner that may wait or be driven."""
    runner_socket: Path | None = None
    """Unix socket of a runner container, which holds the sandboxes. Default: bubblewrap on this machine."""
    model_limit: Annotated[int, Field(ge=1024, le=1 << 30)] = 128 * 1024 * 1024
    """Largest model, bytes."""
    model_memory: Annotated[int, Field(ge=1 << 28)] = 2 * 1024 * 1024 * 1024
    """Memory that the sandbox of a model may take, bytes."""
    submission_keep_days: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 30.0
    """Days to keep the models and logs of submissions that are over."""
    practice_keep_days: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 7.0
    """Days to keep finished practice episodes."""
    abandoned_keep_days: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 30.0
    """Days to keep lost episodes of evaluations that are over, and episodes of cancelled evaluations."""
    unused_keep_days: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 180.0
    """Days to keep owners who registered themselves, and their agents, if they never begin an evaluation."""
    idempotency_keep_hours: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 48.0
    """Hours to keep the reply to an ``Idempotency-Key``."""
    shutdown_grace_s: Seconds = 5.0
    """Seconds that episodes and requests in progress get when the service stops."""
    log_level: Annotated[str, Field(pattern="^(debug|info|warning|error)$")] = "info"
    """Lowest level to log: ``debug``, ``info``, ``warning`` or ``error``."""

    @field_validator("trusted_proxies")
    @classmethod
    def _networks(cls, proxies: str) -> str:
        for item in proxies.split(",") if proxies not in {"", "*"} else ():
            if item.strip() == GATEWAY:
                continue
            try:
                ip_network(item.strip())
            except ValueError as error:
                raise ValueError(f"{item.strip()!r} is neither an address nor a network ({error})") from None
        return proxies

    @field_validator("home")
    @classmethod
    def _absolute(cls, home: Path) -> Path:
        return home.expanduser().absolute()

    @field_validator("public_url")
    @classmethod
    def _of_a_service(cls, url: str | None) -> str | None:
        if url is None:
            return None
        parts = urlsplit(url)
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.fragment:
            raise ValueError("is no URL of a service; write it like https://lab.example/wrongturn")
        return url.rstrip("/")

    @field_validator("operator_token_file", "metrics_token_file")
    @classmethod
    def _readable(cls, file: Path | None, info: ValidationInfo) -> Path | None:
        if file is None:
            return None
        name = str(info.field_name).removesuffix("_file")
        if info.data.get(name) is not None:
            raise ValueError(f"{PREFIX}{name.upper()} is set too; set only one of them")
        read_secret(file)
        return file.absolute()

    @cached_property
    def operator(self) -> Secret:
        """The operator's token."""
        return Secret("operator token", self.operator_token, self.operator_token_file)

    @cached_property
    def metrics(self) -> Secret:
        """The token of the metrics."""
        return Secret("metrics token", self.metrics_token, self.metrics_token_file)

    @field_validator("database_password_file")
    @classmethod
    def _has_password(cls, file: Path | None) -> Path | None:
        if file is None:
            return None
        _password(file)
        return file.absolute()

    @property
    def database_url(self) -> str:
        """URL of the database, with the password of :attr:`database_password_file` if it has none."""
        url = self.database or f"sqlite+aiosqlite:///{self.home / 'wrongturn.db'}"
        return url if self.database_password_file is None else _with_password(url, self.database_password_file)

    @property
    def proxies(self) -> str:
        """Proxies to believe, with the gateway's address in place of its name. Without a gateway it is nobody."""
        names = [name.strip() for name in self.trusted_proxies.split(",")]
        gateway = Machine().gateway() if GATEWAY in names else None
        return ",".join(filter(None, (gateway if name == GATEWAY else name for name in names)))

    @property
    def parallel(self) -> int:
        """Largest number of open episodes of one evaluation."""
        return self.max_parallel or self.simulators

    @property
    def practice(self) -> int:
        """Largest number of open practice episodes of one agent."""
        return self.max_practice or 2 * self.simulators

    @property
    def open_episodes(self) -> int:
        """Largest number of open episodes of one agent."""
        return self.max_open or 4 * self.simulators

    @property
    def open_per_owner(self) -> int:
        """Largest number of open episodes of one owner."""
        return self.max_open_per_owner or 8 * self.simulators

    @property
    def practice_per_owner(self) -> int:
        """Largest number of open practice episodes of one owner."""
        return self.max_practice_per_owner or 4 * self.simulators

    @property
    def open_per_address(self) -> int:
        """Largest number of open episodes that one address has begun."""
        return self.max_open_per_address or 16 * self.simulators

    @property
    def practice_per_address(self) -> int:
        """Largest number of open practice episodes that one address has begun."""
        return self.max_practice_per_address or 8 * self.simulators


def _password(file: Path) -> str:
    """Return the password in a file, without its line end. Raises ValueError."""
    try:
        password = file.read_text("utf-8").rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise ValueError(f"{file} cannot be read ({reason}); name a file with the database's password") from error
    if not password:
        raise ValueError(f"{file} is empty; write the database's password into it")
    return password


def _with_password(url: str, file: Path) -> str:
    from sqlalchemy.engine import make_url  # noqa: PLC0415 - slow, and few need it
    from sqlalchemy.exc import ArgumentError  # noqa: PLC0415

    try:
        parsed = make_url(url)
    except ArgumentError:
        return url  # whoever opens the database says what is wrong with it
    if parsed.get_backend_name() != "postgresql" or parsed.password is not None:
        return url
    return parsed.set(password=_password(file)).render_as_string(hide_password=False)
