"""Where compiled kernels are kept. Imported before numba, which reads its settings once.

Installed code may be read-only (a container, a system-wide installation), so numba must not write beside it: its
cache goes under ``WRONGTURN_HOME``, or to a temporary directory where that cannot be written.
"""

import os
import tempfile
from pathlib import Path
from typing import Final

import platformdirs

CACHE_VARIABLE: Final = "NUMBA_CACHE_DIR"


def home() -> Path:
    """``WRONGTURN_HOME``: data, models and caches of this user."""
    return Path(os.environ.get("WRONGTURN_HOME") or platformdirs.user_data_dir("wrongturn"))


def writable(directory: Path) -> bool:
    """Whether files can be made in the directory, which is made first where it is missing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return True
    except OSError:
        return False


def set_cache() -> Path:
    """Tell numba where to keep its cache, unless the user did; returns the directory."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if not chosen:
        directory = home() / "numba"
        if not writable(directory):
            # Of this process and its children alone: a cache that others may write would run their code.
            directory = Path(tempfile.mkdtemp(prefix="wrongturn-numba-"))
        chosen = os.environ[CACHE_VARIABLE] = str(directory)
    return Path(chosen)
