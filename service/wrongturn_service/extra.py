"""The extra ``server``: what the HTTP service needs and the simulation alone does not."""

from importlib.util import find_spec
from typing import Final

import typer

MODULES: Final = (
    "aiosqlite",
    "alembic",
    "asyncpg",
    "fastapi",
    "httptools",
    "jinja2",
    "msgpack",
    "onnx",
    "onnxruntime",
    "orjson",
    "prometheus_client",
    "pydantic_settings",
    "pyseccomp",
    "python_multipart",
    "scipy",
    "sqlalchemy",
    "structlog",
    "typing_extensions",
    "uvicorn",
    "uvloop",
    "websockets",
)
"""Modules of the extra's packages."""
REMEDY: Final = "pip install 'wrongturn-service[server]'"


def missing_modules() -> list[str]:
    """Return the extra's modules that are not installed."""
    return [name for name in MODULES if find_spec(name) is None]


def require_server(command: str) -> None:
    """Check that the extra is installed. If it is not, say what is missing and exit with status 1."""
    missing = missing_modules()
    if missing:
        typer.echo(f"{command}: {', '.join(missing)}: not installed; {REMEDY}", err=True)
        raise typer.Exit(1)
