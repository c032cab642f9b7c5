"""The folder of this user's data."""

import os
from pathlib import Path

import platformdirs


def home() -> Path:
    """Return ``WRONGTURN_HOME``, the folder of data, models, towns and caches, or the platform's default."""
    return Path(os.environ.get("WRONGTURN_HOME") or platformdirs.user_data_dir("wrongturn"))
