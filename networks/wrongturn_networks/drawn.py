"""Towns that a secret makes: what has a name such as ``drawn-1f2e3d4c5b6a7988`` is built when it is needed.

The 16 digits are the town's seed, so the name alone builds it, byte for byte, on another machine too. What is built is
kept in ``WRONGTURN_HOME``, in the folder ``towns``.

    python -m wrongturn_networks.drawn NAME ...

builds towns, at low priority; :func:`build_towns` runs it in several processes.
"""

import contextlib
import functools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from wrongturn_networks.errors import CorruptFileError, NetworkError, TownBuildError, UnknownTownError
from wrongturn_protocol.home import home
from wrongturn_protocol.installing import install

if TYPE_CHECKING:
    from wrongturn_networks.town import Town

# What builds is imported where it is used: a service only asks for names and starts other processes.

VERSION: Final = 2
"""Version of the towns that names make. Increase it whenever a name makes other bytes: kept towns are then rebuilt."""
SUMO: Final = "1.28.0"
"""Version of SUMO whose netconvert builds them: another one could build other bytes."""
_PREFIX: Final = "drawn-"
_LEFT_S: Final = 3600.0
_DIGITS: Final = 16


def drawn_name(seed: bytes) -> str:
    """Return the name of the town of a seed, of which the first 8 bytes count. Raises ValueError for fewer."""
    if len(seed) < _DIGITS // 2:
        raise ValueError(f"seed: has {len(seed)} bytes; give {_DIGITS // 2} at least")
    return _PREFIX + seed.hex()[:_DIGITS]


def is_drawn(name: object) -> bool:
    """Return whether a name is that of a drawn town."""
    return isinstance(name, str) and re.fullmatch(r"drawn-[0-9a-f]{16}", name) is not None


def is_built(name: str) -> bool:
    """Return whether a drawn town has been built, by the versions of generator and SUMO that are in use."""
    if not is_drawn(name):
        return False
    try:
        manifest = json.loads((_folder(name) / "manifest.json").read_text("utf-8"))
        return (manifest["generator"], manifest["sumo"]) == (VERSION, SUMO)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def build_drawn(name: str) -> Path:
    """Return the folder of a drawn town, and build it first where it is missing.

    Several processes may do so at once. Nobody ever sees a folder that is half written.

    Raises:
        UnknownTownError: The name is not that of a drawn town.
        TownBuildError: netconvert is missing or of another version, or the folder cannot be written.
    """
    if not is_drawn(name):
        raise UnknownTownError(str(name), (drawn_name(bytes(8)),))
    folder = _folder(name)
    if is_built(name):
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=folder.parent) as scratch:
            made = Path(scratch) / name
            make_town(name, made)
            try:
                made.rename(folder)
            except OSError:
                # Another process was faster, or one of another version left its own.
                if not is_built(name):
                    folder.rename(Path(scratch) / "older")
                    made.rename(folder)
    except RuntimeError as error:
        raise TownBuildError(f"town: {name} cannot be built: {error}") from error
    except OSError as error:
        raise TownBuildError(
            f"town: {name} cannot be built in {folder.parent} ({error.strerror or error}); let WRONGTURN_HOME name a "
            "folder that you can write to"
        ) from error
    return folder


def make_town(name: str, folder: Path) -> None:
    """Build the town that a name of any kind draws into a folder. Training has names that no secret gives.

    Raises RuntimeError if netconvert is missing, of another version or fails, and OSError.
    """
    from wrongturn_networks.loading import read_town  # noqa: PLC0415
    from wrongturn_networks.making.checking import flaws  # noqa: PLC0415
    from wrongturn_networks.making.drawing import drawn_recipes  # noqa: PLC0415
    from wrongturn_networks.making.netconvert import build, version  # noqa: PLC0415

    if version() != SUMO:
        raise RuntimeError(f"netconvert is {version()}; {install(f'eclipse-sumo=={SUMO}')}")
    for recipe in drawn_recipes(name):
        build(recipe, folder, generator=VERSION)
        if not any(flaws(read_town(folder))):
            return


def load_drawn(name: str) -> "Town":
    """Return a drawn town, which each process reads once. Raises as :func:`build_drawn`."""
    return _read(build_drawn(name))


def build_towns(names: Iterable[str], processes: int | None = None) -> None:
    """Build those of some drawn towns that are missing, in processes of low priority; one for each core by default.

    Raises :class:`~wrongturn_networks.errors.NetworkError` with what the first process that failed said.
    """
    missing = [name for name in dict.fromkeys(names) if not is_built(name)]
    count = min(len(missing), processes or len(os.sched_getaffinity(0)))
    program = [sys.executable, "-m", "wrongturn_networks.drawn"]
    started = [
        subprocess.Popen([*program, *missing[number::count]], stderr=subprocess.PIPE, text=True)  # noqa: S603 - ours
        for number in range(count)
    ]
    said = [(process.communicate()[1], process.returncode) for process in started]
    for text, status in said:
        if status:
            raise TownBuildError(text.strip().rpartition("\n")[2] or f"town: a builder ended with status {status}")


def forget_unused(keep: int) -> None:
    """Delete those towns that nobody read for the longest time, until ``keep`` are left. Names build them again.

    What builders that were killed have left goes too, after an hour.
    """
    for left in (home() / "towns").glob(f".{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - left.stat().st_mtime > _LEFT_S:
                shutil.rmtree(left)
    folders = [folder for folder in (home() / "towns").glob(f"{_PREFIX}*") if is_drawn(folder.name)]
    for folder in sorted(folders, key=lambda one: one.stat().st_mtime, reverse=True)[keep:]:
        with contextlib.suppress(OSError), tempfile.TemporaryDirectory(prefix=".old-", dir=folder.parent) as scratch:
            # At once for all others: nobody finds a part of it.
            folder.rename(Path(scratch) / folder.name)


def _folder(name: str) -> Path:
    return home() / "towns" / name


@functools.lru_cache(maxsize=64)
def _read(folder: Path) -> "Town":
    from wrongturn_networks.loading import read_town  # noqa: PLC0415

    with contextlib.suppress(OSError):
        os.utime(folder)
    try:
        return read_town(folder)
    except CorruptFileError:
        # The disk lost a part of it, or somebody changed it. The name says how it was.
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as scratch:
            folder.rename(Path(scratch) / folder.name)
        return read_town(build_drawn(folder.name))


def main(names: Iterable[str]) -> int:
    """Build towns, one after the other; the exit status is 1 where one cannot be built."""
    os.nice(10)
    try:
        for name in names:
            build_drawn(name)
    except NetworkError as error:
        print(*str(error).split(), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
