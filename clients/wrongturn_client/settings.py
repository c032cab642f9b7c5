"""Settings from environment variables."""

import os
from pathlib import Path
from typing import Final

from wrongturn_client.errors import SecretFileError

DEFAULT_URL = "http://127.0.0.1:8000"
"""Where ``wrongturn serve`` listens by default."""
OWNER_TOKEN: Final = "WRONGTURN_OWNER_TOKEN"  # noqa: S105 - the variable's name
"""Environment variable with an owner's token, with which agents become that owner's."""
OPERATOR_TOKEN: Final = "WRONGTURN_OPERATOR_TOKEN"  # noqa: S105 - the variable's name
"""Environment variable with the operator's token."""


def service_url() -> str:
    """Return ``WRONGTURN_URL``, or the default URL if it is not set."""
    return os.environ.get("WRONGTURN_URL") or DEFAULT_URL


def token() -> str | None:
    """Return ``WRONGTURN_TOKEN``, or None if it is not set. Raises as :func:`secret`."""
    return secret("WRONGTURN_TOKEN")


def secret(variable: str) -> str | None:
    """Return a secret from a variable, or else from the file that the variable of that name with ``_FILE`` names.

    Raises:
        SecretFileError: The file cannot be read, or is empty.
    """
    named = os.environ.get(f"{variable}_FILE")
    if os.environ.get(variable) or not named:
        return os.environ.get(variable) or None
    try:
        found = Path(named).read_text("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise SecretFileError(
            f"{variable}_FILE: {named} cannot be read ({reason}); name a file with the token"
        ) from error
    if not found:
        raise SecretFileError(f"{variable}_FILE: {named} is empty; write the token into it")
    return found
