"""The tokens of owners that this program registered, by service, in a file of ``WRONGTURN_HOME``.

They let all submissions of a user belong to one owner, although the user keeps no token.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from pydantic import BaseModel, RootModel, ValidationError

from wrongturn_client import settings
from wrongturn_client.errors import WrongturnError

_FILE: Final = "owners.json"


class KeptOwner(BaseModel):
    """An owner with its token."""

    id: str
    name: str
    token: str


class _Kept(RootModel[dict[str, list[KeptOwner]]]):
    """Owners by the URL of their service, the one used last at the end."""


class OwnerTokens:
    """The file of kept tokens; only its user may read it."""

    def __init__(self, home: Path | None = None) -> None:
        """Name the file; nothing is read or written yet.

        Args:
            home: Its folder; ``WRONGTURN_HOME`` by default.
        """
        self.path = (home or settings.home()) / _FILE

    def find(self, url: str, name: str | None = None) -> KeptOwner | None:
        """Return the owner used last at a service, or the one of this name; None if there is none.

        Raises:
            WrongturnError: The file cannot be read.
        """
        there = [owner for owner in self._read().root.get(_origin(url), []) if name in {None, owner.name}]
        return there[-1] if there else None

    def names(self, url: str) -> list[str]:
        """Return the names of the owners that are kept for a service, the one used last at the end.

        Raises:
            WrongturnError: The file cannot be read.
        """
        return [owner.name for owner in self._read().root.get(_origin(url), [])]

    def keep(self, url: str, owner: KeptOwner) -> None:
        """Keep an owner as the one used last at a service; it replaces one of the same name.

        Raises:
            WrongturnError: The file cannot be read or written.
        """
        kept = self._read()
        others = [other for other in kept.root.get(_origin(url), []) if other.name != owner.name]
        kept.root[_origin(url)] = [*others, owner]
        new = self.path.with_suffix(".new")
        try:
            new.unlink(missing_ok=True)
            with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
                file.write(kept.model_dump_json(indent=2) + "\n")
                file.flush()
                os.fsync(file.fileno())
            new.replace(self.path)
        except OSError as error:
            raise self._unwritable(error) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other programs of this user from registering an owner meanwhile.

        Raises:
            WrongturnError: The folder cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.path.with_suffix(".lock"), os.O_WRONLY | os.O_CREAT, 0o600)
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)

    def _read(self) -> _Kept:
        try:
            return _Kept.model_validate_json(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return _Kept({})
        except (OSError, ValidationError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "it does not hold what this program writes"
            raise WrongturnError(
                f"{self.path} cannot be read ({why}); move it away, or set WRONGTURN_OWNER_TOKEN to your token"
            ) from error

    def _unwritable(self, error: OSError) -> WrongturnError:
        return WrongturnError(
            f"{self.path} cannot be written ({error.strerror}), so a new owner's token would be lost; set "
            "WRONGTURN_HOME to a folder that you can write, or WRONGTURN_OWNER_TOKEN to your token"
        )


def _origin(url: str) -> str:
    """Return a URL in one spelling, so that its token is found again."""
    parts = urlsplit(url)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    return f"{parts.scheme}://{parts.hostname}:{port}{parts.path.rstrip('/')}"
