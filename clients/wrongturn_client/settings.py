"""Settings from environment variables."""

import os
from pathlib import Path
from typing import Final

import platformdirs

DEFAULT_URL = "http://127.0.0.1:8000"
"""Where ``wrongturn serve`` listens by default."""
OWNER_TOKEN: Final = "WRONGTURN_OWNER_TOKEN"  # noqa: S105 - the variable's name
"""Environment variable with an owner's token, with which agents become that owner's."""


def service_url() -> str | None:
    """Return ``WRONGTURN_URL``, or None if it is not set."""
    return os.environ.get("WRONGTURN_URL") or None


def token() -> str | None:
    """Return ``WRONGTURN_TOKEN``, or None if it is not set."""
    return os.environ.get("WRONGTURN_TOKEN") or None


def home() -> Path:
    """Return ``WRONGTURN_HOME``, the folder of data, models, own towns and caches, or the platform's default."""
    return Path(os.environ.get("WRONGTURN_HOME") or platformdirs.user_data_dir("wrongturn"))
