"""``wrongturn openenv``. Slow imports wait until the command runs."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from wrongturn_client.errors import WrongturnError


def openenv(
    *,
    url: Annotated[
        str | None,
        typer.Option(
            envvar="WRONGTURN_URL",
            help="Service to practise on; by default one is started. Example: --url http://127.0.0.1:8000",
        ),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on. Example: --host 0.0.0.0")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes a free one. Example: --port 8010")
    ] = 8001,
    track: Annotated[str, typer.Option(help="What the observation holds. Example: --track camera")] = "state",
    town: Annotated[str | None, typer.Option(help="Town to draw trials in. Example: --town Town02")] = None,
    fault: Annotated[str | None, typer.Option(help="Fault of the command. Example: --fault infeasible")] = None,
    suite: Annotated[
        str | None, typer.Option(help="Suite to draw trials from instead. Example: --suite smoke@3")
    ] = None,
    sessions: Annotated[
        int, typer.Option(min=1, max=1000, help="Clients at a time, at most. Example: --sessions 8")
    ] = 64,
) -> None:
    """Let OpenEnv's clients practise on a service, until SIGTERM or Ctrl-C.

    Example: wrongturn openenv --url http://127.0.0.1:8000 --track camera

    Nothing is scored. A client's reset may ask for other trials than these options do: see docs/openenv.md.

    WRONGTURN_TOKEN: the token of an agent at --url. Without one, agents for practice are registered.
    """
    from wrongturn_client import settings  # noqa: PLC0415
    from wrongturn_openenv.server import bind, run  # noqa: PLC0415
    from wrongturn_openenv.session import Service  # noqa: PLC0415
    from wrongturn_protocol import TrialOptions  # noqa: PLC0415

    given = {"track": track, "town": town, "fault": fault, "suite": suite}
    defaults: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    try:
        TrialOptions.of(**defaults)
    except ValueError as error:
        raise WrongturnError(f"--{error}") from None
    with bind(host, port) as listening, _service_at(url) as found:
        service = Service(found, None if url is None else settings.token(), defaults)
        service.check()
        run(service, sessions, listening)


@contextlib.contextmanager
def _service_at(url: str | None) -> Iterator[str]:
    """Yield the URL of a service. Without one, start a service whose database is thrown away at the end."""
    if url is not None:
        yield url
        return
    from wrongturn_client.local_service import FOR_ONE_COMMAND, LocalService  # noqa: PLC0415

    with (
        tempfile.TemporaryDirectory(prefix="wrongturn-openenv-") as folder,
        LocalService(
            database=f"sqlite+aiosqlite:///{Path(folder, 'wrongturn.db')}", environment=FOR_ONE_COMMAND
        ) as service,
    ):
        yield service.url
