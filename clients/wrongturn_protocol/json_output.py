"""``--json``, the same for every command.

``--json`` alone prints JSON and nothing else on stdout. With a file, the command prints what it always prints and also
writes the JSON into that file.
"""

import contextlib
import gzip
import json
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer

STDOUT: Final = Path("-")
"""The file that stands for stdout."""
JsonTo = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="[FILE]",
        help="Print only JSON; with FILE (.json, .json.gz), print as usual and write the JSON there. "
        "Example: --json found.json",
    ),
]
_OPTION: Final = "--json"
_ENDINGS: Final = (".json", ".json.gz")


class JsonFileError(OSError):
    """The file of ``--json`` cannot be written."""


def with_stdout(words: Sequence[str]) -> list[str]:
    """Return a command line in which each ``--json`` without a file is followed by ``-``.

    The word after ``--json`` is its file only if it looks like one. So ``leaderboard --json smoke@3`` prints, and
    ``submit --json model.onnx`` does not overwrite the model. ``--json=FILE`` takes any name.
    """
    changed: list[str] = []
    for position, word in enumerate(words):
        if word == "--":
            return [*changed, *words[position:]]
        changed.append(word)
        if word == _OPTION and not any(_is_file(after) for after in words[position + 1 : position + 2]):
            changed.append(str(STDOUT))
    return changed


def check_json_file(to: Path | None) -> None:
    """Check that JSON can be written into a file, before anything is done for it.

    Raises:
        JsonFileError: It is a folder, or you cannot write to it or to its folder.
    """
    if to is None or to == STDOUT:
        return
    remedy = "name a file in a folder that you can write to"
    try:
        whole = to.resolve()
    except RuntimeError as error:
        raise JsonFileError(f"--json: {to} is a link to itself; {remedy}") from error
    written = to if to.exists() and not to.is_file() else whole.parent  # a pipe or a device is not replaced
    if to.is_dir() or not (written == to or written.is_dir()) or not os.access(written, os.W_OK):
        raise JsonFileError(f"--json: {to} cannot be written; {remedy}")
    if written != to:
        try:  # some folders let nobody make files, whatever their mode says
            with tempfile.TemporaryFile(dir=written):
                pass
        except OSError as error:
            raise JsonFileError(f"--json: {to} cannot be written ({error.strerror}); {remedy}") from error


def give_json(value: Any, to: Path | None) -> bool:
    """Print a value as JSON or write it into a file, as ``--json`` asks for. Call :func:`check_json_file` first.

    The value holds plain values. The file is compressed if its name ends in ``.gz``. Returns whether the command prints
    what it always prints: not if its JSON is on stdout.

    Raises:
        JsonFileError: The file cannot be written.
    """
    if to is None:
        return True
    text = json.dumps(value, indent=2, ensure_ascii=False)
    if to == STDOUT:
        typer.echo(text)
        return False
    write_json(f"{text}\n", to)
    return True


def write_json(text: str, to: Path | None) -> None:
    """Write JSON into the file of ``--json``; None writes nothing. Raises JsonFileError if it cannot be written."""
    if to is None:
        return
    try:
        write_whole([text.encode()], to)
    except OSError as error:
        raise JsonFileError(f"--json: {to} cannot be written ({error.strerror}); name another file") from error


def write_whole(parts: Iterable[bytes], file: Path, *, private: bool = False) -> None:
    """Write a file, all at once or not at all; compressed if its name ends in ``.gz``.

    The same parts give the same bytes. Only its owner may read a ``private`` file, which is on the disk at the end.

    Raises:
        OSError: The file cannot be written.
    """
    if file.exists() and not file.is_file():  # a pipe or a device, which nothing can replace
        with file.open("wb") as out:
            out.writelines(parts)
        return
    target = file.resolve()  # a link stays a link
    new = target.with_name(f".{target.name}.new")
    try:
        with open(new, "wb", opener=_opened_by_owner if private else None) as out:
            if target.suffix == ".gz":
                with gzip.GzipFile(filename="", mode="wb", fileobj=out, mtime=0) as packed:
                    packed.writelines(parts)
            else:
                out.writelines(parts)
            if private:
                out.flush()
                os.fsync(out.fileno())
        new.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)
        raise


def _is_file(word: str) -> bool:
    return word == str(STDOUT) or word.endswith(_ENDINGS) or word.startswith("/dev/")


def _opened_by_owner(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)
