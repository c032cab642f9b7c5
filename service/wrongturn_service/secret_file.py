"""Secrets of the operator: given in the environment, or in a file that is read at each use.

A file that is written anew takes effect at once, without a restart: the old secret is refused from then on.
"""

from pathlib import Path
from typing import Final

import structlog
from pydantic import SecretStr

from wrongturn_service.tokens import same

SHORTEST: Final = 16
"""Characters that a secret in a file needs, so that a half-written file is no short secret."""
_LONGEST: Final = 4096


class Secret:
    """A secret that a caller has to send.

    Args:
        name: What it is, for the log.
        given: The secret itself. None without one.
        file: The file that holds it instead. None without one.
    """

    def __init__(self, name: str, given: SecretStr | None, file: Path | None) -> None:
        self._name = name
        self._given = given
        self._file = file
        self._logged = ""

    @property
    def required(self) -> bool:
        """Whether a secret is configured. If its file is unreadable, every caller is refused."""
        return self._given is not None or self._file is not None

    def is_(self, told: str) -> bool:
        """Return whether somebody told the secret, in constant time."""
        if self._file is None:
            return self._given is not None and same(told, self._given.get_secret_value())
        try:
            current = read_secret(self._file)
        except ValueError as error:
            if str(error) != self._logged:
                self._logged = str(error)
                log = structlog.get_logger("secrets")
                log.error("every caller is refused: the file cannot be used", secret=self._name, reason=str(error))
            return False
        self._logged = ""
        return same(told, current)


def read_secret(file: Path) -> str:
    """Return the secret in a file, without the spaces and line ends around it. Raises ValueError."""
    try:
        with file.open("rb") as opened:
            secret = opened.read(_LONGEST + 1).decode("ascii").strip()
    except OSError as error:
        raise ValueError(f"{file} cannot be read ({error.strerror}); write the secret into it") from error
    except UnicodeDecodeError:
        raise ValueError(f"{file} holds other characters than ASCII; write a new secret into it") from None
    if not SHORTEST <= len(secret) <= _LONGEST or not secret.isprintable() or " " in secret:
        raise ValueError(
            f"{file} holds no secret of {SHORTEST} to {_LONGEST} printable characters without spaces; write one into it"
        )
    return secret
