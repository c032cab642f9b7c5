"""Checks of this installation."""

import platform
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from typing import Final

from rich.table import Table
from rich.text import Text

from wrongturn_client import plugins
from wrongturn_client.client import Client
from wrongturn_client.errors import WrongturnError
from wrongturn_client.tables import list_table
from wrongturn_protocol.home import home

_LEAST_PYTHON: Final = (3, 11)
_PARTS: Final = {
    "wrongturn-client": "the client and this program",
    "wrongturn-networks": "towns and suites",
    "wrongturn-service": "the simulation, the judge and the service",
    "wrongturn-agents": "agents: 'wrongturn run'",
}


@dataclass(frozen=True)
class Check:
    """Result of one check."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""
    """What to do if the check failed."""


def diagnose(url: str | None) -> Iterator[Check]:
    """Run all checks, one after the other, with those of a service if a URL is given."""
    version = platform.python_version()
    yield Check("Python", sys.version_info[:2] >= _LEAST_PYTHON, version, "install Python 3.11 or newer")
    for part, what in _PARTS.items():
        yield _part(part, what)
    yield _home()
    for finding in plugins.checks():
        yield Check(*finding)
    if url is not None:
        yield _service(url)


def report(checks: list[Check]) -> Table:
    """Return the results as a table."""
    rows = []
    for check in checks:
        mark = Text("ok", style="green") if check.ok else Text("FAILED", style="bold red")
        finding = check.detail if check.ok or not check.remedy else f"{check.detail}\nTo do: {check.remedy}"
        rows.append((mark, check.name, finding))
    return list_table(("", "check", "finding"), rows)


def _part(part: str, what: str) -> Check:
    try:
        return Check(part, True, f"{metadata.version(part)}: {what}")
    except metadata.PackageNotFoundError:
        return Check(part, part != "wrongturn-client", f"not installed; needed for {what}", f"install {part}")


def _home() -> Check:
    folder = home()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        return Check(
            "WRONGTURN_HOME", False, f"{folder} cannot be written: {reason}", "set WRONGTURN_HOME to a folder that can"
        )
    return Check("WRONGTURN_HOME", True, f"{folder} can be written")


def _service(url: str) -> Check:
    try:
        with Client(url, patience=0, timeout=10) as client:
            client.ready()
            return Check("service", True, f"{client.url} is ready")
    except WrongturnError as error:
        return Check("service", False, str(error), "start it with 'wrongturn serve', or correct --url or WRONGTURN_URL")
