"""Compiled functions that call those of other files.

Numba's cache looks at a function's own file alone: after a change to what it calls it would go on with the old code.
So the cached name of such a function carries a checksum of the files that it takes anything from.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled_with(*modules: ModuleType, **options: Any) -> Callable[[_Function], _Function]:
    """As ``njit(cache=True, **options)``, for a function that takes from these modules, or through them of one another.

    What is taken may be another compiled function or a constant: both are frozen into the code that is kept.
    """
    digest = hashlib.sha256()
    for module in modules:
        digest.update(Path(str(module.__file__)).read_bytes())

    def compiled(function: _Function) -> _Function:
        function.__qualname__ += f"_{digest.hexdigest()[:12]}"
        return cast(_Function, njit(cache=True, **options)(function))

    return compiled
