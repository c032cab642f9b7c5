"""The extra ``server``: what the HTTP service needs and the simulation alone does not."""

import re
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Final

import typer

REMEDY: Final = "pip install 'wrongturn-service[server]'"


def missing_packages() -> list[str]:
    """Return the extra's packages that are not installed."""
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
    """Check that the extra is installed. If it is not, say what is missing and exit with status 1."""
    missing = missing_packages()
    if missing:
        typer.echo(f"{command}: {', '.join(missing)}: not installed; {REMEDY}", err=True)
        raise typer.Exit(1)
