"""Files with a recording: CSV or JSON. Errors name the line of a CSV file, or the field and index in JSON."""

import csv
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from wrongturn_judge.errors import RecordingError
from wrongturn_judge.recordings import judged
from wrongturn_judge.trajectory import Trajectory
from wrongturn_networks.loading import town_named
from wrongturn_protocol import Judgement, RecordedUser, Recording
from wrongturn_protocol.suggestions import did_you_mean

_MOST_BYTES: Final = 4 << 20
_REMEDY: Final = "give a recording as CSV or JSON, as docs/judge.md shows"


def judge_file(file: Path) -> tuple[Judgement, Trajectory]:
    """Return what :func:`~wrongturn_judge.recordings.judged` returns for a file, and raise what it raises."""
    try:
        with file.open("rb") as stream:
            text = stream.read(_MOST_BYTES).decode("utf-8-sig").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        raise RecordingError("file", f"cannot be read ({why}); {_REMEDY}") from error
    if not 0 < len(text) < _MOST_BYTES:
        raise RecordingError("file", f"is empty, or larger than {_MOST_BYTES >> 20} MiB; {_REMEDY}, thinned to 20 Hz")
    lines: dict[str | int, int] = {}
    try:
        json = text.startswith("{")
        found = Recording.model_validate_json(text) if json else Recording.model_validate(_fields(text, lines))
        return judged(found.model_copy(update={"town": town_named(found.town)}))
    except (ValidationError, RecordingError) as error:
        told = _refusal(error) if isinstance(error, ValidationError) else error
        line = lines.get(told.field if told.row is None else told.row)
        raise told if line is None else RecordingError(f"line {line}", f"{told.field}: {told.problem}") from None


def _fields(text: str, lines: dict[str | int, int]) -> dict[str, Any]:
    """Return the fields of a CSV file, and fill in the lines of header entries, columns and rows."""
    found, names, rows = dict[str, Any](), list[str](), list[list[str]]()
    for number, line in enumerate(text.splitlines(), 1):
        name, colon, value = map(str.strip, line[1:].partition(":"))
        cells = [cell.strip() for cell in next(csv.reader([line]), [])]
        if line.startswith("#"):
            if not colon or name in lines:
                raise RecordingError(f"line {number}", "is no new header entry; write '# name: value' once")
            lines[name], found[name] = number, value
        elif cells and not names:
            names = cells
            if len({*names, *lines}) < len(names) + len(lines):
                raise RecordingError(f"line {number}", "names a column that is there already; keep one")
            lines |= dict.fromkeys(names, number)
        elif cells:
            if len(cells) != len(names):
                raise RecordingError(
                    f"line {number}", f"has {len(cells)} cells; give one for each of {len(names)} columns"
                )
            lines[len(rows)] = number
            rows.append(cells)
    found |= dict(zip(names, zip(*rows, strict=True), strict=False))
    return {**found, **({"others": ()} if found.get("others") == "none" else {})}


def _refusal(error: ValidationError) -> RecordingError:
    """Return the first error in a recording's fields, with the remedy. An unknown field comes first."""
    first = min(error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden")
    kind, path = first["type"], [*map(str, first["loc"])]
    if kind == "json_invalid":
        return RecordingError("file", f"is not JSON ({first['ctx']['error']}); {_REMEDY}")
    row = int(path.pop()) if path[-1].isdecimal() else None
    fields = (RecordedUser if path[0] == "others" and len(path) > 1 else Recording).model_fields
    if kind == "extra_forbidden":
        return RecordingError(".".join(path), f"is unknown; leave it out{did_you_mean(path[-1], fields)}")
    known = fields[path[-1]].description if path[-1] in fields else None
    given = {"missing": "missing", "too_short": "has too few rows", "too_long": "has too many rows"}.get(kind)
    problem = (
        f"{given or 'is ' + repr(first['input'])[:40]}; give {known or 'finite numbers in the units of the header'}"
    )
    return RecordingError(".".join(path), problem, row)
