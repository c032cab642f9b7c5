"""``wrongturn backup`` and ``wrongturn restore``. Heavy imports wait until a command runs."""

import contextlib
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer

from wrongturn_service.cli import read_settings, require_server

_STREAM: Final = Path("-")

Url = Annotated[
    str | None,
    typer.Option(
        help="SQLAlchemy URL. Default: WRONGTURN_DATABASE, or wrongturn.db in WRONGTURN_HOME. "
        "Example: --database sqlite+aiosqlite:////data/w.db",
        metavar="URL",
        show_default=False,
    ),
]


def backup(
    file: Annotated[
        Path, typer.Argument(help="New file for the backup; - writes to stdout. Example: wrongturn-2026-11-22.backup")
    ],
    database: Url = None,
) -> None:
    """Write a consistent backup of the database. The service may run meanwhile.

    Example: wrongturn backup wrongturn-2026-11-22.backup
    """
    require_server("backup")
    from wrongturn_service.errors import StartupError  # noqa: PLC0415
    from wrongturn_service.storage.backup import back_up  # noqa: PLC0415 - imports SQLAlchemy

    settings = read_settings(database=database)
    if file == _STREAM and sys.stdout.isatty():
        raise typer.BadParameter("a backup is binary: name a file, or redirect stdout to one", param_hint="FILE")
    try:
        with _staged(file, settings.home) as written:
            back_up(settings.database_url, written)
            size = written.stat().st_size
            if file == _STREAM:
                # Only now that it is whole.
                with written.open("rb") as backup_file:
                    shutil.copyfileobj(backup_file, sys.stdout.buffer)
                    sys.stdout.buffer.flush()
    except StartupError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    typer.echo(f"{'The backup' if file == _STREAM else file} has {size} bytes", err=file == _STREAM)


def restore(
    file: Annotated[
        Path,
        typer.Argument(help="A file that 'wrongturn backup' wrote; - reads it from stdin. Example: wrongturn.backup"),
    ],
    database: Url = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask. What is in the database now is lost.")] = False,
) -> None:
    """Replace the database by a backup. Stop the service first.

    Example: wrongturn restore wrongturn-2026-11-22.backup
    """
    require_server("restore")
    from wrongturn_service.errors import StartupError  # noqa: PLC0415
    from wrongturn_service.storage import backup as backups  # noqa: PLC0415 - imports SQLAlchemy

    settings = read_settings(database=database)
    if file == _STREAM and not yes:
        raise typer.BadParameter("stdin is the backup, so it cannot answer the question: give --yes", param_hint="FILE")
    try:
        if file != _STREAM:
            backups.check_file(file)
        if not yes:
            typer.confirm(f"Replace everything in {settings.database_url.rsplit('@', 1)[-1]}?", abort=True)
        with _staged(file, settings.home) as read:
            if file == _STREAM:
                with read.open("xb") as backup_file:
                    shutil.copyfileobj(sys.stdin.buffer, backup_file)
            backups.restore(settings.database_url, read, settings.home)
    except StartupError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    typer.echo("Restored. Episodes that were open at the time of the backup run again.")


@contextlib.contextmanager
def _staged(file: Path, home: Path) -> Iterator[Path]:
    """Yield the file, or for a stream one in the home that is deleted afterwards. Raises StartupError."""
    from wrongturn_service.errors import StartupError  # noqa: PLC0415

    if file != _STREAM:
        yield file
        return
    try:
        home.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=home, prefix=".backup-")  # mode 0700
    except OSError as error:
        raise StartupError(
            f"WRONGTURN_HOME: {home} cannot be written ({error.strerror}); a stream goes through a file there"
        ) from error
    with folder as name:
        yield Path(name) / "backup"
