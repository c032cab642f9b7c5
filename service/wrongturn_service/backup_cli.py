"""``wrongturn backup`` and ``wrongturn restore``. Heavy imports wait until a command runs."""

from pathlib import Path
from typing import Annotated, Any

import typer

Url = Annotated[
    str | None,
    typer.Option(
        help="SQLAlchemy URL. Default: WRONGTURN_DATABASE, or wrongturn.db in WRONGTURN_HOME.",
        metavar="URL",
        show_default=False,
    ),
]


def backup(
    file: Annotated[Path, typer.Argument(help="New file for the backup. Example: wrongturn-2026-11-22.backup")],
    database: Url = None,
) -> None:
    """Write a consistent backup of the database. The service may run meanwhile."""
    from wrongturn_service.errors import StartupError  # noqa: PLC0415
    from wrongturn_service.storage.backup import back_up  # noqa: PLC0415 - imports SQLAlchemy

    settings = _settings(database)
    try:
        back_up(settings.database_url, file)
    except StartupError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    typer.echo(f"{file} has {file.stat().st_size} bytes")


def restore(
    file: Annotated[Path, typer.Argument(help="A file that 'wrongturn backup' wrote.")],
    database: Url = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask. Everything in the database now is lost.")] = False,
) -> None:
    """Replace the database by a backup. Stop the service first."""
    from wrongturn_service.errors import StartupError  # noqa: PLC0415
    from wrongturn_service.storage import backup as backups  # noqa: PLC0415 - imports SQLAlchemy

    settings = _settings(database)
    if not yes:
        typer.confirm(f"Replace everything in {settings.database_url.rsplit('@', 1)[-1]}?", abort=True)
    try:
        backups.restore(settings.database_url, file, settings.home)
    except StartupError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    typer.echo("Restored. Episodes that were open at the time of the backup run again.")


def _settings(database: str | None) -> Any:
    from pydantic import ValidationError  # noqa: PLC0415

    from wrongturn_service.settings import PREFIX, Settings  # noqa: PLC0415

    try:
        return Settings() if database is None else Settings(database=database)
    except ValidationError as error:
        for item in error.errors(include_url=False, include_input=False):
            typer.echo(f"{PREFIX}{'.'.join(map(str, item['loc'])).upper()}: {item['msg']}", err=True)
        raise typer.Exit(2) from None
