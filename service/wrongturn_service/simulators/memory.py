"""Memory of processes."""

import re
from pathlib import Path
from typing import Final

_SHARE: Final = re.compile(rb"^Pss:\s+(\d+) kB", re.MULTILINE)
_RESIDENT: Final = re.compile(rb"^VmRSS:\s+(\d+) kB", re.MULTILINE)


def memory_of(pid: int) -> int:
    """Return a process's own memory and its part of what it shares, bytes; 0 if the process has ended.

    Where the kernel does not tell the parts, the result is the process's resident memory.
    """
    return _read(f"/proc/{pid}/smaps_rollup", _SHARE) or _read(f"/proc/{pid}/status", _RESIDENT)


def _read(path: str, pattern: re.Pattern[bytes]) -> int:
    try:
        match = pattern.search(Path(path).read_bytes())
    except OSError:
        return 0
    return 1024 * int(match[1]) if match else 0
