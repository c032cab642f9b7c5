"""The service's settings: ``WRONGTURN_*`` variables or options of ``serve``."""

from enum import StrEnum
from functools import cached_property
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Final
from urllib.parse import urlsplit

import platformdirs
from pydantic import Field, SecretStr, ValidationInfo, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from wrongturn_protocol.installing import ray
from wrongturn_runner import SANDBOXES
from wrongturn_service.machine import Machine
from wrongturn_service.secret_file import Secret, read_secret

PREFIX = "WRONGTURN_"
CHECKS: Final = 2
"""Submissions that are checked at a time, each in a sandbox."""
_MOST: Final = 4096
"""Most simulators of one service."""
_MOST_ON_RAY: Final = 1024
"""Most simulators on Ray if no number is given."""
GATEWAY = "gateway"
"""Stands for the address of the default gateway."""
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Registration(StrEnum):
    """Who may register agents."""

    OPEN = "open"
    OPERATOR = "operator"


class Place(StrEnum):
    """Where runners run."""

    LOCAL = "local"
    RAY = "ray"


def sandboxes(submissions: int, socket: Path | None) -> int:
    """Return how many sandboxes this machine may have at a time, with so many submissions driven and two checked."""
    return 0 if submissions == 0 or socket is not None else SANDBOXES * submissions + CHECKS


class Settings(BaseSettings):
    """The service's settings. ``python lab/settings_page.py`` writes their docstrings into ``docs/settings.md``.

    A default that is computed stands at the end of its docstring: ``Default: …``
    """

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, frozen=True, extra="forbid", use_attribute_docstrings=True, env_ignore_empty=True
    )

    host: str = "127.0.0.1"
    """Address to listen on. `0.0.0.0` means every address of the machine: then put a proxy with TLS in front of it."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on. 0 takes a free port; the ready line says which."""
    public_url: str | None = None
    """URL at which people reach the service behind a proxy, such as `https://lab.example/wrongturn`. The pages and the
    OpenAPI document name it. Default: that of each request."""
    home: Path = Field(default_factory=lambda: Path(platformdirs.user_data_dir("wrongturn")))
    """Folder for the database, models that were handed in, and compiled code. Default: the platform's data folder."""
    database: str = ""
    """URL of the database, as SQLAlchemy writes it. For PostgreSQL: `postgresql+asyncpg://user:password@host/name`.
    Only one service can use a database at a time. The folder of a SQLite file has to exist; the service creates only
    its home. Default: `wrongturn.db` in the home."""
    database_password_file: Path | None = None
    """File with the password of a PostgreSQL database whose URL has none."""
    operator_token: SecretStr | None = None
    """Bearer token of the operator. Without it there is no operator."""
    operator_token_file: Path | None = None
    """File with that token, in its place, of at least 16 characters. It is read at each use, so a new token takes
    effect at once."""
    signing_key_file: Path | None = None
    """File with the Ed25519 private key that signs certificates, 64 hexadecimal digits. The service reads it at the
    start, and when the operator rotates the key. Default: one that the first start makes, kept in the database."""
    registration: Registration = Registration.OPEN
    """`open`: anybody may register owners and agents. `operator`: only the operator registers owners, and owners
    register their agents by their token."""
    registration_limit: Annotated[int, Field(ge=1)] = 100
    """Owners and agents that one address may register within an hour. The operator is exempt, and so are agents that
    register with their owner's token."""
    agents_per_owner: Annotated[int, Field(ge=1)] = 100
    """Agents of one owner. One more gets 507 `quota-reached`."""
    accounts_per_address: Annotated[int, Field(ge=2)] = 1000
    """Owners and agents that one address may have registered in all. One more gets 507 `quota-reached`."""
    bytes_per_owner: Annotated[int, Field(ge=1 << 20)] = 1 << 30
    """Bytes that may be stored for one owner. What does not fit gets 507 `quota-reached`."""
    bytes_per_address: Annotated[int, Field(ge=1 << 20)] = 4 << 30
    """Bytes that may be stored for all owners that one address has registered."""
    disk_reserve: Annotated[int, Field(ge=0)] = 1 << 30
    """Bytes that stay free on the disks of home and SQLite database, at most 5 % of a disk. With less on the home's,
    models get 507 `storage-failed`; with less on the database's, registrations and practice. Evaluations go on."""
    metrics_token: SecretStr | None = None
    """Bearer token for `GET /metrics`. The operator's opens it too. Without either, only programs of the service's own
    machine may read the metrics."""
    metrics_token_file: Path | None = None
    """File with that token, in its place, of at least 16 characters. It is read at each use."""
    metrics_port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """A port for `/metrics` alone, at the same address. The main port then answers 404 there."""
    submissions: Annotated[int, Field(ge=0, le=256)] = Field(
        default_factory=lambda: max(1, Machine().processors() // 2)
    )
    """Submissions driven at a time. 0 turns them off. Default: half the cores, at least 1."""
    runner_socket: Path | None = None
    """Unix socket of a runner container, whose sandboxes run the models. Without it they run under bubblewrap on this
    machine."""
    simulators: int | str = Field(
        default_factory=lambda settings: Machine().simulators(
            sandboxes(settings.get("submissions", 0), settings.get("runner_socket"))
        )
    )
    """Largest number of simulators that drive. Each is a process that starts when it is first needed, and then stays.
    The default leaves 1 GiB for the service, 256 MiB for each sandbox on this machine and 200 MiB for each simulator;
    in a container, the limits of its cgroup count. `ray` runs them on a Ray cluster, four for each of its cores;
    `ray:100` at most 100 there. Default: four times the cores, at least 16, as far as the memory is enough."""
    spare_simulators: Annotated[int, Field(ge=0, le=64)] = 1
    """Simulators kept ready beyond those that drive, to replace one that dies at once."""
    simulator_start_timeout_s: Positive = 180.0
    """Seconds in which a simulator process must be ready. The first on a machine compiles its code."""
    simulator_timeout_s: Positive = 30.0
    """Seconds after which a simulator that does not answer counts as dead; for a step, at most 5. Its episode is
    replayed in another one, which gets 0.02 s more for each step."""
    lease_release_s: Positive = 10.0
    """Seconds without a call after which the simulator of an episode goes to other agents. It is rebuilt by replay."""
    lease_abort_s: Positive = 600.0
    """Seconds without a call after which an episode is `aborted`."""
    max_parallel: Annotated[int, Field(ge=1)] = Field(
        default_factory=lambda settings: _most(settings.get("simulators", 1))
    )
    """Open episodes of one evaluation. Default: as many as `WRONGTURN_SIMULATORS`; for `ray`, 1024."""
    max_open: Annotated[int, Field(ge=1)] = Field(
        default_factory=lambda settings: 4 * _most(settings.get("simulators", 1))
    )
    """Open episodes of one agent; half of them may be practice. An owner may have twice as many, and an address four
    times. One more gets 429 `rate-limited`. Default: four times `WRONGTURN_SIMULATORS`."""
    evaluation_idle_h: Positive = 24.0
    """Hours without a reset or a step after which a running evaluation is closed, as DELETE closes it."""
    evaluation_days: Positive = 7.0
    """Days that a driven evaluation may take. Then it is closed, however active its agent is."""
    max_waiting: Annotated[int, Field(ge=1)] = 64
    """Calls of one agent in the queue for a simulator. One more gets 429 `rate-limited`."""
    max_line: Annotated[int, Field(ge=1)] = 1024
    """Calls of all agents in the queue for a simulator. One more gets 503 `simulators-busy` and no place in it."""
    max_sockets: Annotated[int, Field(ge=1)] = 32
    """Connections of one agent to `/v1/drive`. One connection carries any number of episodes."""
    max_sockets_per_address: Annotated[int, Field(ge=1)] = 256
    """Connections from one address to `/v1/drive`."""
    max_connections: Annotated[int, Field(ge=1)] = 4096
    """Connections of all clients. One more gets 503 `service-full`."""
    slow_client_s: Positive = 30.0
    """Seconds in which a client must send a whole request or message, or the next 64 KiB of it, and take a reply, or 64
    KiB of it."""
    ping_interval_s: Positive = 20.0
    """Seconds between two pings on a connection to `/v1/drive`."""
    ping_timeout_s: Positive = 60.0
    """Seconds without an answer to a ping after which a client counts as gone. An agent may think for that long."""
    trusted_proxies: str = ""
    """Addresses and networks of proxies, separated by commas, whose `X-Forwarded-For` names the client's address.
    `gateway` is the default gateway, which for a container is its machine. With `*` any client can claim any
    address."""
    submissions_per_owner: Annotated[int, Field(ge=1)] = 8
    """Submissions of one owner that may wait or be driven. One more gets 429 `rate-limited`."""
    runners: Place = Place.LOCAL
    """Where models are driven: `local` on this machine, `ray` on the nodes of the Ray cluster that have a sandbox. For
    `ray` the settings of Ray count, wherever simulators run."""
    runner_url: str | None = None
    """URL at which runners on Ray's nodes reach this service, such as `http://10.0.0.1:8000`. Default: the address to
    listen on; for `0.0.0.0`, the address that Ray has for this machine."""
    runner_gpus: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of a GPU that a runner on Ray gets, such as 0.25. With it ONNX Runtime computes on the GPU, and the sandbox
    lets the model reach the GPU's driver. Outputs may then differ in their last digits."""
    model_limit: Annotated[int, Field(ge=1024, le=1 << 30)] = 128 * 1024 * 1024
    """Largest model in bytes."""
    model_memory: Annotated[int, Field(ge=1 << 28)] = 2 * 1024 * 1024 * 1024
    """Memory in bytes that a model may take in its sandbox."""
    submission_keep_days: Positive = 30.0
    """Days for which the models and logs of submissions that are over are kept."""
    practice_keep_days: Positive = 7.0
    """Days for which finished practice episodes are kept. Scored episodes are never deleted."""
    abandoned_keep_days: Positive = 30.0
    """Days for which lost episodes of evaluations that are over, and episodes of cancelled evaluations, are kept."""
    unused_keep_days: Positive = 180.0
    """Days after which owners are deleted with their agents, if they registered themselves, have neither an evaluation
    nor a submission, and stored nothing new."""
    idempotency_keep_hours: Positive = 48.0
    """Hours for which the reply to an `Idempotency-Key` is kept."""
    shutdown_grace_s: Positive = 5.0
    """Seconds for which a stopping service waits for episodes that are being driven and for requests in progress."""
    log_level: Annotated[str, Field(pattern="^(debug|info|warning|error)$")] = "info"
    """Lowest level to log: `debug`, `info`, `warning` or `error`. Logs are JSON lines on stderr."""

    @field_validator("simulators", mode="before")
    @classmethod
    def _simulators(cls, given: int | str) -> int | str:
        where, colon, number = str(given).rpartition(":") if str(given) != Place.RAY else (Place.RAY, "", "1")
        count = int(number) if number.isdecimal() else 0
        if where not in {"", Place.RAY} or (colon and not where) or not 1 <= count <= _MOST:
            raise ValueError(f"is {str(given)!r}; give a number from 1 to {_MOST}, 'ray', or 'ray:' and a number")
        if not where:
            return count
        ray("settings")
        return given

    @field_validator("runners")
    @classmethod
    def _with_ray(cls, place: Place) -> Place:
        if place is Place.RAY:
            ray("settings")
        return place

    @field_validator("runner_gpus")
    @classmethod
    def _only_on_ray(cls, share: float, info: ValidationInfo) -> float:
        if share and info.data.get("runners") is Place.LOCAL:
            raise ValueError(f"needs runners on Ray; set {PREFIX}RUNNERS to ray, or this to 0")
        return share

    @property
    def on_ray(self) -> bool:
        """Whether simulators run on a Ray cluster."""
        return isinstance(self.simulators, str)

    @property
    def uses_ray(self) -> bool:
        """Whether simulators or runners run on a Ray cluster."""
        return self.on_ray or self.runners is Place.RAY

    def checked(self) -> "Settings":
        """Return these, once the variables about Ray are checked too if it is used. Raises ValidationError."""
        if self.uses_ray:
            ray("settings")()
        return self

    @property
    def most_simulators(self) -> int:
        """Largest number of simulators that drive; a cluster may have room for fewer."""
        return _most(self.simulators)

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

    @field_validator("public_url", "runner_url")
    @classmethod
    def _of_a_service(cls, url: str | None) -> str | None:
        if url is None:
            return None
        parts = urlsplit(url)
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.fragment:
            raise ValueError("is no URL of a service; write it like https://lab.example/wrongturn")
        return url.rstrip("/")

    @field_validator("operator_token_file", "metrics_token_file", "signing_key_file")
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


def _most(simulators: int | str) -> int:
    """Return the largest number of simulators that a checked setting allows."""
    return simulators if isinstance(simulators, int) else int(simulators.partition(":")[2] or _MOST_ON_RAY)


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
