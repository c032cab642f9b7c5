"""How much memory a process has, so that what it shares with others is counted once."""

import re
from pathlib import Path
from typing import Final

_SHARE: Final = re.compile(rb"^Pss:\s+(\d+) kB", re.MULTILINE)
_RESIDENT: Final = re.compile(rb"^VmRSS:\s+(\d+) kB", re.MULTILINE)
_AVAILABLE: Final = re.compile(rb"^MemAvailable:\s+(\d+) kB", re.MULTILINE)


def memory_of(pid: int) -> int:
    """Bytes; 0 of a process that is gone.

    Its own pages and its part of those that it shares; all that is resident where the kernel does not tell parts.
    """
    return _read(f"/proc/{pid}/smaps_rollup", _SHARE) or _read(f"/proc/{pid}/status", _RESIDENT)


def available_memory() -> int:
    """Bytes that this machine can still give; 0 where it does not tell."""
    return _read("/proc/meminfo", _AVAILABLE)


def _read(path: str, pattern: re.Pattern[bytes]) -> int:
    try:
        found = pattern.search(Path(path).read_bytes())
    except OSError:
        return 0
    return 1024 * int(found[1]) if found else 0
