"""Where compiled kernels are kept. Imported before numba, which reads its settings once.

Installed code may be read-only (a container, a system-wide installation), so numba must not write beside it: its
cache goes under ``WRONGTURN_HOME``, or to a temporary directory where that cannot be written.

On x86-64 the instruction set is pinned, so that a picture's bytes do not hang on the machine: fast arithmetic rounds as
the instructions allow.
"""

import os
import platform
import tempfile
from pathlib import Path
from typing import Final

import platformdirs

CACHE_VARIABLE: Final = "NUMBA_CACHE_DIR"
CPU_VARIABLE: Final = "NUMBA_CPU_NAME"
CPU: Final = "x86-64-v3"
"""AVX2 and FMA, which every machine that the benchmark promises its bytes for has."""


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
    """Tell numba where to keep its cache and which processor to compile for, unless the user did.

    Returns the directory of the cache.
    """
    if CPU_VARIABLE not in os.environ and platform.machine().lower() in {"x86_64", "amd64"}:
        os.environ[CPU_VARIABLE] = CPU
        # Nothing beyond it: numba would add what it finds in the machine at hand.
        os.environ.setdefault("NUMBA_CPU_FEATURES", "")
    chosen = os.environ.get(CACHE_VARIABLE)
    if not chosen:
        directory = home() / "numba"
        if not writable(directory):
            # Of this process and its children alone: a cache that others may write would run their code.
            directory = Path(tempfile.mkdtemp(prefix="wrongturn-numba-"))
        chosen = os.environ[CACHE_VARIABLE] = str(directory)
    return Path(chosen)
