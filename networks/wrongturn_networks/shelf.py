"""Towns and suites by name: those of this package, of other packages that are installed, and the user's own.

Another package names a town's folder by an entry point in the group ``wrongturn.towns``, or a suite's file by one in
the group ``wrongturn.suites``. ``docs/extending.md`` shows both. The user's own lie in ``WRONGTURN_HOME``, or are named
by their paths in ``WRONGTURN_TOWNS`` and ``WRONGTURN_SUITES``. What cannot be used is left out, and the rest works.
"""

import functools
import logging
import os
from collections.abc import Callable, Iterable
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, TypeVar

from wrongturn_networks.errors import CorruptFileError, NetworkError, UnknownNameError

_T = TypeVar("_T")


class Shelf(Generic[_T]):
    """All towns, or all suites. Each process reads one once.

    Those of other packages come from entry points of the ``group``, each of which names a ``Path``; ``check`` raises an
    error for one of them that cannot be driven. ``own`` returns the paths in the user's folder, and the environment's
    ``variable`` lists more.
    """

    def __init__(
        self,
        group: str,
        shipped: Iterable[Path],
        read: Callable[[Path], _T],
        unknown: type[UnknownNameError],
        own: Callable[[], Iterable[Path]],
        variable: str,
        check: Callable[[_T], object] = lambda _: None,
    ) -> None:
        self._group, self._check, self._unknown = group, check, unknown
        self._own_folder, self._variable = own, variable
        self._flaw = functools.lru_cache(maxsize=256)(self._flaw_of)
        self._shipped = {_name_of(path): path for path in sorted(shipped)}
        self._read = functools.lru_cache(maxsize=64)(read)
        self.left_out: dict[str, str] = {}
        """Why entry points of other packages cannot be used, by their names."""

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted. The user's own that cannot be used are left out."""
        own = (name for name, path in self._own().items() if self._flaw(path) is None)
        return tuple(sorted({*self._shipped, *self._others, *own}))

    def load(self, name: str) -> _T:
        """Return the town or suite of a name. Raises the error for unknown names, or CorruptFileError."""
        # The name may come from a stranger and be anything, so only paths that were found here are read.
        for paths in (self._shipped, self._others):
            if name in tuple(paths):
                return self._read(paths[name])
        own = self._own()
        if name in tuple(own):
            if (flaw := self._flaw(own[name])) is not None:
                raise CorruptFileError(flaw)
            return self._read(own[name])
        raise self._unknown(name, self.names())

    def name_of(self, text: str) -> str:
        """Return the name of what a *user* names: a path is read, and stays known to this process and its children.

        Never give it what comes from a stranger. Raises NetworkError for a path that cannot be used.
        """
        path = Path(text).expanduser()
        if (os.sep in text or path.suffix == ".json") and not path.exists():
            raise NetworkError(f"{text}: there is no such file or folder; correct its path")
        if text in {*self._shipped, *self._others} or not (os.sep in text or path.exists()):
            return text
        path = path.resolve()
        if self._own().get(_name_of(path)) != path:
            if (name := _name_of(path)) in {*self._shipped, *self._others, *self._own()}:
                raise NetworkError(f"{path}: there is another {name}; give this one a name of its own")
            self._check(self._read(path))
            listed = filter(None, (os.environ.get(self._variable), str(path)))
            os.environ[self._variable] = os.pathsep.join(listed)
        return _name_of(path)

    def _own(self) -> dict[str, Path]:
        """Paths of the user's own by their names, none of which is a name of a package's."""
        named = map(Path, filter(None, os.environ.get(self._variable, "").split(os.pathsep)))
        found = {_name_of(path): path for path in (*self._own_folder(), *named)}
        return {name: path for name, path in found.items() if name not in self._shipped and name not in self._others}

    def _flaw_of(self, path: Path) -> str | None:
        try:
            self._check(self._read(path))
        except Exception as error:  # one broken file must not keep a service from starting
            logging.getLogger(__name__).warning("%s is left out: %s", path, error)
            return str(error)
        return None

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
