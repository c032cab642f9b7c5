"""How a command goes on with what the file of its ``--json`` has."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, TypeVar

from pydantic import BaseModel, ValidationError

from wrongturn_agents.errors import RunError
from wrongturn_protocol.run_file import UNREADABLE, read_unpacked, reason_of

_REMEDY: Final = "name a new file, or the file of the run to resume"
_File = TypeVar("_File", bound=BaseModel)


def resume(begun: _File, file: Path | None, none: Mapping[str, object]) -> _File:
    """Return what a file has of the run that begins, or ``begun`` if there is no file.

    ``none`` has the fields of results, as they are at the beginning. Raises RunError if the file cannot be read, or is
    of another run.
    """
    if file is None or not file.exists():
        return begun
    try:
        found = type(begun).model_validate_json(read_unpacked(file))
    except UNREADABLE as error:
        raise RunError(f"--json: {file} cannot be read ({reason_of(error)}); {_REMEDY}") from error
    except ValidationError as error:
        raise RunError(f"--json: {file} is no file of this command; {_REMEDY}") from error
    if found.model_copy(update=dict(none)) != begun:
        raise RunError(f"--json: {file} is of another run; {_REMEDY}")
    return found
