"""Everything that can be set about the service, by ``WRONGTURN_*`` in the environment or by options of ``serve``."""

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import platformdirs
from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

PREFIX = "WRONGTURN_"
Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Registration(StrEnum):
    """Who may register an agent."""

    OPEN = "open"
    OPERATOR = "operator"


class Settings(BaseSettings):
    """The service's settings; each is described in ``docs/settings.md``."""

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
    """Port to listen on; 0 takes a free one."""
    home: Path = Field(default_factory=lambda: Path(platformdirs.user_data_dir("wrongturn")))
    """Where data, models, own towns and caches lie."""
    database: str = ""
    """SQLAlchemy's URL of the database; ``wrongturn.db`` in the home, an SQLite file, by default."""
    operator_token: SecretStr | None = None
    """The operator's bearer token; without it nobody is the operator."""
    registration: Registration = Registration.OPEN
    """``open``: anybody may register an agent. ``operator``: only the operator's token may."""
    registration_limit: Annotated[int, Field(ge=1)] = 100
    """Agents that one address may register within an hour; the operator's token is exempt."""
    simulators: Annotated[int, Field(ge=1, le=4096)] = Field(
        default_factory=lambda: max(16, 4 * (os.cpu_count() or 1)),
    )
    """Simulators that drive at most; each is a process, started when it is first needed and then kept."""
    spare_simulators: Annotated[int, Field(ge=0, le=64)] = 1
    """Simulators kept warm beyond those that drive, so that one that dies is replaced at once."""
    simulator_start_timeout_s: Seconds = 180.0
    """Seconds in which a simulator process must be ready; the first on a machine compiles its arithmetic."""
    simulator_timeout_s: Seconds = 30.0
    """Seconds after which a simulator that does not answer counts as dead.

    5 at most for a step; a replay has 0.02 more for each."""
    lease_release_s: Seconds = 10.0
    """Seconds of an agent's silence after which its episode's simulator is given to others."""
    lease_abort_s: Seconds = 600.0
    """Seconds of an agent's silence after which its episode is ``aborted``."""
    max_parallel: Annotated[int, Field(ge=1)] | None = None
    """Episodes of one evaluation that may be open at a time; as many as there are simulators by default."""
    max_practice: Annotated[int, Field(ge=1)] | None = None
    """Practice episodes of one agent that may be open at a time; twice as many as there are simulators by default."""
    max_open: Annotated[int, Field(ge=1)] | None = None
    """Episodes of one agent that may be open at a time, scored and practice; four times the simulators by default."""
    max_evaluations: Annotated[int, Field(ge=1)] = 32
    """Evaluations of one agent that may be running at a time."""
    max_waiting: Annotated[int, Field(ge=1)] = 64
    """Calls of one agent that may stand in the line for a simulator."""
    max_line: Annotated[int, Field(ge=1)] = 1024
    """Calls that may stand in the line for a simulator."""
    max_sockets: Annotated[int, Field(ge=1)] = 32
    """Connections to ``/v1/drive`` of one agent."""
    max_sockets_per_address: Annotated[int, Field(ge=1)] = 256
    """Connections to ``/v1/drive`` from one address."""
    max_connections: Annotated[int, Field(ge=1)] = 4096
    """Connections at a time, of all clients."""
    slow_client_s: Seconds = 30.0
    """Seconds in which a request, or the next 64 KiB of it, has to come, and a reply to be taken."""
    ping_interval_s: Seconds = 20.0
    """Seconds between two pings of a connection to ``/v1/drive``."""
    ping_timeout_s: Seconds = 60.0
    """Seconds after which a client that answers no ping is taken for gone; an agent may think for that long."""
    trusted_proxies: str = "127.0.0.1,::1"
    """Addresses and networks of proxies whose ``X-Forwarded-For`` is believed, with commas between; ``*`` for all."""
    body_limit: Annotated[int, Field(ge=1024)] = 4 * 1024 * 1024
    """Bytes that a request's body may have."""
    practice_keep_days: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 7.0
    """Days for which finished practice episodes are kept."""
    idempotency_keep_hours: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 48.0
    """Hours for which the reply to an ``Idempotency-Key`` is kept."""
    shutdown_grace_s: Seconds = 5.0
    """Seconds that episodes that are being driven, and requests in progress, get when the service is stopped."""
    log_level: Annotated[str, Field(pattern="^(debug|info|warning|error)$")] = "info"
    """The least level that is logged: ``debug``, ``info``, ``warning`` or ``error``."""

    @field_validator("home")
    @classmethod
    def _absolute(cls, home: Path) -> Path:
        return home.expanduser().absolute()

    @property
    def database_url(self) -> str:
        """The database's URL, the default filled in."""
        return self.database or f"sqlite+aiosqlite:///{self.home / 'wrongturn.db'}"

    @property
    def parallel(self) -> int:
        """Episodes of one evaluation that may be open at a time."""
        return self.max_parallel or self.simulators

    @property
    def practice(self) -> int:
        """Practice episodes of one agent that may be open at a time."""
        return self.max_practice or 2 * self.simulators

    @property
    def open_episodes(self) -> int:
        """Episodes of one agent that may be open at a time."""
        return self.max_open or 4 * self.simulators
