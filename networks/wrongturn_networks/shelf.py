"""Towns and suites by name: those of this package, and those of other packages that are installed.

Another package names a town's folder by an entry point in the group ``wrongturn.towns``, or a suite's file by one in
the group ``wrongturn.suites``. ``docs/extending.md`` shows both. What cannot be used is left out, and the rest works.
"""

import functools
import logging
from collections.abc import Callable, Iterable
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, TypeVar

from wrongturn_networks.errors import UnknownNameError

_T = TypeVar("_T")


class Shelf(Generic[_T]):
    """All towns, or all suites. Each process reads one once.

    Those of other packages come from entry points of the ``group``, each of which names a ``Path``; ``check`` raises an
    error for one of them that cannot be driven.
    """

    def __init__(
        self,
        group: str,
        shipped: Iterable[Path],
        read: Callable[[Path], _T],
        unknown: type[UnknownNameError],
        check: Callable[[_T], object] = lambda _: None,
    ) -> None:
        self._group, self._check, self._unknown = group, check, unknown
        self._shipped = {_name_of(path): path for path in sorted(shipped)}
        self._read = functools.lru_cache(maxsize=64)(read)
        self.left_out: dict[str, str] = {}
        """Why entry points of other packages cannot be used, by their names."""

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted."""
        return tuple(sorted({*self._shipped, *self._others}))

    def load(self, name: str) -> _T:
        """Return the town or suite of a name. Raises the error for unknown names, or CorruptFileError."""
        # The name may come from a stranger and be anything, so only paths that were found here are read.
        for paths in (self._shipped, self._others):
            if name in tuple(paths):
                return self._read(paths[name])
        raise self._unknown(name, self.names())

    @functools.cached_property
    def _others(self) -> dict[str, Path]:
        """Paths of other packages. Each is read at once: a broken one is named here, and does no harm later."""
        found: dict[str, Path] = {}

        def take(_: str, loaded: Any) -> None:
            path = Path(loaded)
            if (name := _name_of(path)) in {*self._shipped, *found}:
                raise ValueError(f"there is another {name}; give this one a name of its own")
            self._check(self._read(path))
            found[name] = path

        self.left_out = take_installed(self._group, take)
        return found


def take_installed(group: str, take: Callable[[str, Any], None]) -> dict[str, str]:
    """Load what other packages name in a group of entry points, and give each to ``take`` with its name.

    Returns:
        Why some cannot be used, by their names: they could not be loaded, or ``take`` raised.
    """
    left_out = {}
    for point in sorted(metadata.entry_points(group=group), key=lambda point: (_package(point), point.name)):
        try:
            take(point.name, point.load())
        except Exception as error:  # it is another package's code
            label = f"{point.name} of {_package(point)} ({point.value})"
            left_out[label] = str(error) or type(error).__name__
            logging.getLogger(__name__).warning("%s: %s is left out: %s", group, label, left_out[label])
    return left_out


def _name_of(path: Path) -> str:
    return path.name.removesuffix(".json")


def _package(point: metadata.EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "its package"
