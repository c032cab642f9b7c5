"""Cached compilation of functions that call functions of other files.

Numba's cache only notices changes to a function's own file. After a change to a function that it calls, the old code
would run on. So the cached name of a function carries a checksum of all files of ours that its file imports.
"""

import contextlib
import functools
import hashlib
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import event
from typing_extensions import override

from wrongturn_judge.home import CACHE_VARIABLE

_Function = TypeVar("_Function", bound=Callable[..., Any])

_IMPORT: Final = re.compile(r"^from ([\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_PACKAGES: Final = ("wrongturn_judge", "wrongturn_sim", "wrongturn_protocol")
"""Packages whose functions and constants numba freezes into compiled code."""


def compiled(**options: Any) -> Callable[[_Function], _Function]:
    """Return a decorator like ``njit(cache=True, **options)`` for a function that may depend on other modules."""

    def decorate(function: _Function) -> _Function:
        function.__qualname__ += f"_{_digest(function.__module__)}"
        return cast(_Function, njit(cache=True, **options)(function))

    return decorate


@functools.cache
def _digest(module: str) -> str:
    """Return a checksum of a module and of all that it imports from our packages, directly or not."""
    found: dict[str, bytes] = {}
    _read(module, found)
    return hashlib.sha256(b"".join(found[name] for name in sorted(found))).hexdigest()[:12]


def _read(module: str, found: dict[str, bytes]) -> None:
    package, *rest = module.split(".")
    folder = Path(str(sys.modules[package].__file__)).parent
    file = folder.joinpath(*rest).with_suffix(".py")
    if module in found or not rest or not file.is_file():
        return
    found[module] = file.read_bytes()
    for whole, names in _IMPORT.findall(found[module].decode()):
        # What a file of the protocol imports is no number or function that a kernel uses.
        if package != "wrongturn_protocol" and whole.partition(".")[0] in {package, *_PACKAGES}:
            for name in (whole, *(f"{whole}.{name}" for name in re.findall(r"\w+", names))):
                _read(name, found)


def uncounted(function: _Function) -> _Function:
    """Compile a function that allocates nothing, without numba's reference counts.

    Counting would take most of the time of a function that looks at one row of an array after the other.
    """
    options: Any = {"_nrt": False}
    return cast(_Function, njit(**options)(function))


def record(floats: str, ints: str = "") -> np.dtype[Any]:
    """Return the type of a record with these fields of eight bytes; names have spaces between them.

    Rows of records are kept as plain float64 arrays, which numba recognises ten times as fast in a call from Python. A
    kernel looks at them through the type: ``row.view(CAR)[0].speed``.
    """
    return np.dtype((np.record, [(n, "f8") for n in floats.split()] + [(n, "i8") for n in ints.split()]))


def words(kind: np.dtype[Any]) -> int:
    """Return the number of a record's fields, which is the length of its row."""
    return kind.itemsize // 8


class _Announcer(event.Listener):
    """Says once on stderr that kernels are compiled: otherwise the first start would be silent for minutes."""

    @override
    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"].py_func.__module__.startswith("wrongturn") and _first():
            print(
                "wrongturn: compiling the simulation for this machine, once; that takes one to three minutes",
                file=sys.stderr,
                flush=True,
            )

    @override
    def on_end(self, event: Any) -> None:
        pass


_HOUR_S: Final = 3600.0


def _first() -> bool:
    """Return whether no process has said so within the last hour, by a file beside the kernels."""
    said = Path(os.environ[CACHE_VARIABLE]) / "compiling"
    with contextlib.suppress(OSError):
        if said.exists() and time.time() - said.stat().st_mtime < _HOUR_S:
            return False
        said.parent.mkdir(parents=True, exist_ok=True)
        said.touch()
        return True
    return False


event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]
