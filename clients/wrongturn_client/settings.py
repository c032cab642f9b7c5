"""What the environment tells the client."""

import os
from pathlib import Path

import platformdirs

DEFAULT_URL = "http://127.0.0.1:8000"
"""Where ``wrongturn serve`` listens when nobody asks for anything else."""


def service_url() -> str | None:
    """``WRONGTURN_URL``, or None where it is not set."""
    return os.environ.get("WRONGTURN_URL") or None


def token() -> str | None:
    """``WRONGTURN_TOKEN``, or None where it is not set."""
    return os.environ.get("WRONGTURN_TOKEN") or None


def home() -> Path:
    """``WRONGTURN_HOME``: data, models, own towns and caches; the platform's place for them by default."""
    return Path(os.environ.get("WRONGTURN_HOME") or platformdirs.user_data_dir("wrongturn"))
