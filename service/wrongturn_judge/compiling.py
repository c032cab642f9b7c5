"""Cached compilation of functions that call functions of other files.

Numba's cache only notices changes to a function's own file. After a change to a function that it calls, the old code
would run on. So the cached name of a function carries a checksum of the files that it depends on.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled_with(*modules: ModuleType, **options: Any) -> Callable[[_Function], _Function]:
    """Return a decorator like ``njit(cache=True, **options)`` for a function that depends on other modules.

    Args:
        modules: those whose compiled functions or constants the function uses, itself or through another one. Numba
            freezes both into the cached code.
        options: for ``njit``.
    """
    digest = hashlib.sha256()
    for module in modules:
        digest.update(Path(str(module.__file__)).read_bytes())

    def compiled(function: _Function) -> _Function:
        function.__qualname__ += f"_{digest.hexdigest()[:12]}"
        return cast(_Function, njit(cache=True, **options)(function))

    return compiled


def uncounted(function: _Function) -> _Function:
    """Compile a function that allocates nothing, without numba's reference counts.

    Counting would take most of the time of a function that looks at one row of an array after the other.
    """
    options: Any = {"_nrt": False}
    return cast(_Function, njit(**options)(function))
