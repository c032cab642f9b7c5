"""Where compiled kernels are kept. Import this before numba, which reads its settings once.

Installed code may be read-only, as in a container. So numba's cache goes under ``WRONGTURN_HOME``, or into a temporary
directory where that cannot be written.

An image can ship its kernels: ``python -m wrongturn_sim`` compiles them into the directory that ``WRONGTURN_KERNELS``
names. Numba ignores a cache that it cannot write, so it gets a copy. The copy's name is a checksum of its content, so
kernels of an older image on the same volume are never mixed in.

On x86-64 the instruction set is pinned: fast arithmetic rounds differently with other instructions, and a picture's
bytes must not depend on the machine.
"""

import hashlib
import os
import platform
import shutil
import tempfile
from pathlib import Path
from typing import Final

from wrongturn_protocol.home import home

CACHE_VARIABLE: Final = "NUMBA_CACHE_DIR"
KERNELS_VARIABLE: Final = "WRONGTURN_KERNELS"
CPU_VARIABLE: Final = "NUMBA_CPU_NAME"
CPU: Final = "x86-64-v3"
"""AVX2 and FMA: what a machine needs for the bytes that the benchmark promises."""


def writable(directory: Path) -> bool:
    """Return whether files can be created in a directory; create it where it is missing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return True
    except OSError:
        return False


def set_cache() -> Path:
    """Set numba's cache directory and target processor, unless the user did, and return the directory."""
    if CPU_VARIABLE not in os.environ and platform.machine().lower() in {"x86_64", "amd64"}:
        os.environ[CPU_VARIABLE] = CPU
        # Empty, or numba adds the features of this machine's processor.
        os.environ.setdefault("NUMBA_CPU_FEATURES", "")
    chosen = os.environ.get(CACHE_VARIABLE)
    if not chosen:
        parent, compiled = home(), os.environ.get(KERNELS_VARIABLE)
        if not writable(parent if compiled else parent / "numba"):
            # Private to this process and its children: a cache that others can write would run their code.
            parent = Path(tempfile.mkdtemp(prefix="wrongturn-numba-"))
        directory = _copied(Path(compiled), parent) if compiled else parent / "numba"
        chosen = os.environ[CACHE_VARIABLE] = str(directory)
    return Path(chosen)


def _copied(compiled: Path, parent: Path) -> Path:
    """Return the copy in ``parent`` of a directory of kernels; make it where it is missing, and delete older ones."""
    digest = hashlib.sha256()
    for file in sorted(path for path in compiled.rglob("*") if path.is_file()):
        digest.update(f"{file.relative_to(compiled)}\n{file.stat().st_size}\n".encode())
        digest.update(file.read_bytes())
    directory = parent / f"numba-{digest.hexdigest()[:12]}"
    if directory.is_dir():
        return directory
    # A rename: other processes that start now see a complete copy or none.
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
