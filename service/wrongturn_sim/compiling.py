"""Compiled functions that call those of other files.

Numba's cache looks at a function's own file alone: after a change to what it calls it would go on with the old code.
So the cached name of such a function carries a checksum of the files that it calls into.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled_with(*modules: ModuleType, nogil: bool = False) -> Callable[[_Function], _Function]:
    """As ``njit(cache=True)``, for a function that calls into these modules, or through them into one another."""
    digest = hashlib.sha256()
    for module in modules:
        digest.update(Path(str(module.__file__)).read_bytes())

    def compiled(function: _Function) -> _Function:
        function.__qualname__ += f"_{digest.hexdigest()[:12]}"
        return cast(_Function, njit(cache=True, nogil=nogil)(function))

    return compiled
