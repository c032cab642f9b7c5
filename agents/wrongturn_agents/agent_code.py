"""The files of an agent's code, by which a resumed run notices that they have changed."""

import hashlib
import inspect
from collections.abc import Iterable, Mapping
from pathlib import Path

from wrongturn_agents.errors import AgentImportError


def files_of_class(agent: type) -> tuple[Path, ...]:
    """Return the files in which a class and the classes that it is made of are written, without those of Python."""
    files: dict[Path, None] = {}
    for part in agent.__mro__:
        try:
            found = inspect.getsourcefile(part)
        except (TypeError, OSError):  # built in, or typed into an interpreter
            continue
        if found is not None and Path(found).is_file():
            files[Path(found).resolve()] = None
    return tuple(files)


def checksums(files: Iterable[Path]) -> dict[str, str]:
    """Return the SHA-256 of each file by its path.

    Raises:
        AgentImportError: A file cannot be read.
    """
    found = {}
    for file in files:
        try:
            with file.open("rb") as opened:
                found[str(file.resolve())] = hashlib.file_digest(opened, "sha256").hexdigest()
        except OSError as error:
            raise AgentImportError(f"agent: {file} cannot be read ({error.strerror})") from error
    return found


def changed(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the files of an agent's code that were changed, added or taken away, sorted."""
    return sorted(file for file in before.keys() | now.keys() if before.get(file) != now.get(file))
