"""``wrongturn serve``, and the service's checks for ``wrongturn doctor``. Heavy imports wait until a command runs."""

import gc
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from wrongturn_protocol.installing import install, ray

if TYPE_CHECKING:
    from pydantic import ValidationError

    from wrongturn_service.settings import Settings

_USAGE = 2
_SERVER: Final = "wrongturn-service[server]"
_ENDS_WITH_PARENT: Final = "WRONGTURN_ENDS_WITH_PARENT"
"""Environment variable that ``wrongturn_client.LocalService`` sets."""


def serve(
    host: Annotated[
        str | None,
        typer.Option(help="Address to listen on. Default: 127.0.0.1. Example: --host 0.0.0.0", show_default=False),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            help="Port to listen on. Default: 8000. 0 takes a free port. Example: --port 8080",
            min=0,
            max=65535,
            show_default=False,
        ),
    ] = None,
    database: Annotated[
        str | None,
        typer.Option(
            help="SQLAlchemy URL. Default: wrongturn.db in WRONGTURN_HOME. "
            "Example: --database sqlite+aiosqlite:////data/w.db",
            metavar="URL",
            show_default=False,
        ),
    ] = None,
    suites: Annotated[
        list[str] | None,
        typer.Option(
            "--suite", metavar="FILE", help="File of a suite of your own; can be repeated. Example: --suite mine@1.json"
        ),
    ] = None,
    towns: Annotated[
        list[str] | None,
        typer.Option(
            "--town", metavar="FOLDER", help="Folder of a town of your own; can be repeated. Example: --town village"
        ),
    ] = None,
) -> None:
    """Run the service until SIGTERM or Ctrl-C.

    Example: wrongturn serve --port 8000

    It prints its URL once it is ready. Other settings come from WRONGTURN_* variables, see docs/settings.md.
    """
    require_server("serve")
    _stop_with_parent()
    from wrongturn_service.address import AddressError, bind  # noqa: PLC0415
    from wrongturn_service.errors import StartupError  # noqa: PLC0415

    if towns or suites:
        from wrongturn_networks.catalogue import find_suite, find_town  # noqa: PLC0415

        names = [*(find_town(town).name for town in towns or ()), *(find_suite(suite).id for suite in suites or ())]
        typer.echo(f"with {', '.join(names)}", err=True)
    settings = read_settings(host=host, port=port, database=database)
    from wrongturn_service.storage.location import parse  # noqa: PLC0415 - imports SQLAlchemy

    try:
        parse(settings.database_url)
        bound = bind(settings.host, settings.port, settings.slow_client_s)
    except (StartupError, AddressError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(_USAGE) from None
    gc.disable()  # hardly anything that is imported is garbage
    from wrongturn_service import logs, server  # noqa: PLC0415 - slow, so only once the address is bound

    gc.enable()

    logs.configure(settings.log_level)
    try:
        server.run(settings, bound)
    except StartupError as error:
        typer.echo(f"Wrongturn cannot start: {error}", err=True)
        raise typer.Exit(1) from None


def read_settings(**given: Any) -> "Settings":
    """Return the settings with what was given on the command line. None was not given.

    A wrong value is named, and ends the command with status 2.
    """
    from pydantic import ValidationError  # noqa: PLC0415

    from wrongturn_service.settings import Settings  # noqa: PLC0415

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None}).checked()
    except ValidationError as error:
        typer.echo("\n".join(wrong_settings(error)), err=True)
        raise typer.Exit(_USAGE) from None


def wrong_settings(error: "ValidationError") -> Iterator[str]:
    """Yield a line for each wrong setting. One whose default follows from a wrong one is not wrong itself."""
    from wrongturn_service.settings import PREFIX  # noqa: PLC0415

    for item in error.errors(include_url=False, include_input=False):
        if item["type"] != "default_factory_not_called":
            message = item["msg"].removeprefix("Value error, ")
            yield f"{PREFIX}{'.'.join(map(str, item['loc'])).upper()}: {message}"


def _stop_with_parent() -> None:
    """Stop this process as by SIGTERM at the end of stdin, if the parent asks for that.

    Stdin is then a pipe whose other end only the parent has. The system closes it even after ``kill -9``.
    """
    if os.environ.pop(_ENDS_WITH_PARENT, None):
        threading.Thread(target=_await_end, args=(sys.stdin.fileno(),), name="parent", daemon=True).start()


def _await_end(pipe: int) -> None:
    while os.read(pipe, 1):
        pass
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for closed in (1, 2):  # nobody reads them any more, and writing to them would fail
        os.dup2(nowhere, closed)
    os.kill(os.getpid(), signal.SIGTERM)


def _signing_key(file: Path | None) -> tuple[str, bool, str, str]:
    """Check the key that signs certificates."""
    if file is None:
        return "signing key", True, "in the database, so backups keep it", ""
    from wrongturn_service.certificates import key_in  # noqa: PLC0415

    try:
        key_in(file)
    except ValueError as error:
        return "signing key", False, str(error), "correct it; see docs/certificates.md"
    return "signing key", True, f"in {file}; backups do not hold it", ""


def checks() -> Iterator[tuple[str, bool, str, str]]:
    """Yield each check as its name, whether it passed, what it found, and the remedy if it failed."""
    if missing_packages():
        yield "service", True, f"not installed; to run one: {install(_SERVER)}", ""
        return
    from pydantic import ValidationError  # noqa: PLC0415

    from wrongturn_service.errors import StartupError  # noqa: PLC0415
    from wrongturn_service.machine import Machine  # noqa: PLC0415
    from wrongturn_service.settings import Settings  # noqa: PLC0415
    from wrongturn_service.storage.check import examine  # noqa: PLC0415

    try:
        settings = Settings().checked()
    except ValidationError as error:
        yield "settings", False, "\n".join(wrong_settings(error)), "correct these variables, see docs/settings.md"
        return
    machine = Machine()
    yield (
        "settings",
        True,
        f"database {settings.database_url.rsplit('@', 1)[-1]}; {settings.most_simulators} simulators on "
        f"{machine.processors()} processors with {machine.memory() >> 20} MiB",
        "",
    )
    try:
        found = examine(settings.database_url, settings.home)
    except StartupError as error:
        remedy = "set WRONGTURN_DATABASE to a database that works"
        if not settings.database:
            remedy += ", or WRONGTURN_HOME to a folder that you can write to"
        yield "database", False, str(error), remedy
    else:
        yield "database", True, found, ""
    yield _signing_key(settings.signing_key_file)
    from wrongturn_service.simulators import check  # noqa: PLC0415
    from wrongturn_service.simulators.interface import SimulatorStartError  # noqa: PLC0415

    try:
        yield "simulators", True, check.examine(settings), ""
    except SimulatorStartError as error:
        remedy = "see the checks of libsumo and the kernels; if the machine was only slow, run this again"
        yield "simulators", False, str(error), "start Ray as docs/cluster.md shows" if settings.on_ray else remedy
    except check.TooLittleMemoryError as error:
        yield "simulators", False, str(error), "lower WRONGTURN_SIMULATORS or WRONGTURN_SUBMISSIONS, or add memory"
    from wrongturn_sandbox import SandboxUnavailableError, probe  # noqa: PLC0415
    from wrongturn_service.settings import sandboxes  # noqa: PLC0415
    from wrongturn_service.submissions.availability import TURNED_OFF  # noqa: PLC0415

    if settings.submissions == 0:
        yield "submissions", True, f"off: {TURNED_OFF}", ""
        return
    try:
        found = ray("probe")(settings) if settings.runners == "ray" else probe(settings.runner_socket)
        most = f"each model may take {settings.model_memory >> 20} MiB"
        yield "submissions", True, f"on: {found}; {sandboxes(settings.submissions, None)} sandboxes, {most}", ""
    except SandboxUnavailableError as error:
        remedy = "without a sandbox the service refuses submissions; WRONGTURN_SUBMISSIONS=0 turns them off"
        yield "submissions", False, str(error), remedy


def missing_packages() -> list[str]:
    """Return the packages of the extra ``server``, which the simulation alone does not need, that are not installed."""
    return [name for name in _packages() if not _installed(name)]


def _packages() -> list[str]:
    wanted = [line for line in requires("wrongturn-service") or () if re.search(r"""extra == ["']server["']""", line)]
    return [re.split(r"[^\w.-]", line)[0] for line in wanted]


def _installed(name: str) -> bool:
    try:
        return bool(version(name))
    except PackageNotFoundError:
        return False


def require_server(command: str) -> None:
    """Check that the extra ``server`` is installed. If it is not, say what is missing and exit with status 1."""
    missing = missing_packages()
    if missing:
        typer.echo(f"{command}: {', '.join(missing)}: not installed; {install(_SERVER)}", err=True)
        raise typer.Exit(1)
