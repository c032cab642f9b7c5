"""Where compiled kernels are kept. Imported before numba, which reads its settings once.

Installed code may be read-only (a container, a system-wide installation), so numba must not write beside it: its
cache goes under ``WRONGTURN_HOME``, or to a temporary directory where that cannot be written.

An image can bring its kernels along: what ``python -m wrongturn_sim`` compiled into the directory that
``WRONGTURN_KERNELS`` names. Numba uses no cache that it cannot write, so it gets a copy of that one, which it adds to
where the machine at hand needs other code. A copy is named after its content: what an older image left on the volume is
never mixed with it.

On x86-64 the instruction set is pinned, so that a picture's bytes do not hang on the machine: fast arithmetic rounds as
the instructions allow.
"""

import hashlib
import os
import platform
import shutil
import tempfile
from pathlib import Path
from typing import Final

import platformdirs

CACHE_VARIABLE: Final = "NUMBA_CACHE_DIR"
KERNELS_VARIABLE: Final = "WRONGTURN_KERNELS"
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
        parent, compiled = home(), os.environ.get(KERNELS_VARIABLE)
        if not writable(parent if compiled else parent / "numba"):
            # Of this process and its children alone: a cache that others may write would run their code.
            parent = Path(tempfile.mkdtemp(prefix="wrongturn-numba-"))
        directory = _copied(Path(compiled), parent) if compiled else parent / "numba"
        chosen = os.environ[CACHE_VARIABLE] = str(directory)
    return Path(chosen)


def _copied(compiled: Path, parent: Path) -> Path:
    """The copy in ``parent`` of this directory of compiled kernels, made where it is missing; older ones go."""
    digest = hashlib.sha256()
    for file in sorted(path for path in compiled.rglob("*") if path.is_file()):
        digest.update(f"{file.relative_to(compiled)}\n{file.stat().st_size}\n".encode())
        digest.update(file.read_bytes())
    directory = parent / f"numba-{digest.hexdigest()[:12]}"
    if directory.is_dir():
        return directory
    # Complete or not there at all, also where several processes start at once.
    with tempfile.TemporaryDirectory(prefix=".numba-", dir=parent) as made:
        shutil.copytree(compiled, Path(made) / "numba")
        try:
            (Path(made) / "numba").rename(directory)
        except OSError:
            if not directory.is_dir():
                raise
    for older in (parent / "numba", *parent.glob("numba-*")):
        if older != directory:
            shutil.rmtree(older, ignore_errors=True)
    return directory
