"""Secrets of the operator: given in the environment, or in a file that is read at each use.

A file that is written anew takes effect at once, without a restart: the old secret is refused from then on.
"""

from pathlib import Path
from typing import Final

import structlog
from pydantic import SecretStr

from wrongturn_service.tokens import digest, same

SHORTEST: Final = 16
"""Characters that a secret in a file needs, so that a half-written file is no short secret."""
_LONGEST: Final = 4096


class SecretFileError(ValueError):
    """A file with a secret cannot be used. The message says why and what to do."""


class Secret:
    """A secret that a caller has to send.

    Args:
        name: What it is, for the log.
        given: The secret itself. None without one.
        file: The file that holds it instead. None without one.
    """

    def __init__(self, name: str, given: SecretStr | None, file: Path | None) -> None:
        self._log = structlog.get_logger("secrets").bind(secret=name)
        self._given = None if given is None else given.get_secret_value()
        self._file = file
        self._known: str | None = None
        self._told = ""

    @property
    def required(self) -> bool:
        """Whether a secret is configured. If its file is unreadable, every caller is refused."""
        return self._given is not None or self._file is not None

    def is_(self, told: str) -> bool:
        """Return whether somebody told the secret, in constant time."""
        current = self._current()
        return current is not None and same(told, current)

    def _current(self) -> str | None:
        if self._file is None:
            return self._given
        try:
            current = read_secret(self._file)
        except SecretFileError as error:
            if str(error) != self._told:
                self._told = str(error)
                self._log.error("nobody has the secret, because its file cannot be used", reason=str(error))
            return None
        self._told = ""
        known, self._known = self._known, digest(current)
        if known not in {None, self._known}:
            self._log.warning("secret replaced; the old one has ended")
        return current


def read_secret(file: Path) -> str:
    """Return the secret in a file, without the spaces and line ends around it.

    Raises:
        SecretFileError: The file cannot be read, or holds no secret.
    """
    try:
        with file.open("rb") as opened:
            content = opened.read(_LONGEST + 1)
    except OSError as error:
        raise SecretFileError(f"{file} cannot be read ({error.strerror}); write the secret into it") from error
    try:
        secret = content.decode("ascii").strip()
    except UnicodeDecodeError:
        raise SecretFileError(f"{file} holds other characters than ASCII; write a new secret into it") from None
    if not SHORTEST <= len(secret) <= _LONGEST or not secret.isprintable() or " " in secret:
        raise SecretFileError(
            f"{file} holds no secret of {SHORTEST} to {_LONGEST} printable characters without spaces; write one into it"
        )
    return secret
