"""A cache for what depends on a town's net alone, so that towns which differ only in scenery share it."""

import functools
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from wrongturn_networks.town import Town

_P = ParamSpec("_P")
_T = TypeVar("_T")
_OfTown = Callable[Concatenate[Town, _P], _T]


def once_per_net(maxsize: int) -> Callable[[_OfTown[_P, _T]], _OfTown[_P, _T]]:
    """Return a decorator that keeps the last results of a function of a town, whose scenery does not matter."""

    def decorated(function: _OfTown[_P, _T]) -> _OfTown[_P, _T]:
        cached = functools.lru_cache(maxsize)(function)

        @functools.wraps(function)
        def of(town: Town, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
            return cached(town.plain, *args, **kwargs)  # type: ignore[arg-type]

        return of

    return decorated
