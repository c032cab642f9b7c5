"""What this machine gives the service: processors, memory and a gateway. In a container, its cgroup's limits count.

A process sees its own cgroup (version 2) and those above it; each may have a limit.
"""

import errno
import os
import re
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
_CGROUPS: Final = Path("/sys/fs/cgroup")
_SERVICE: Final = 1 << 30
"""Memory to leave for the service itself, bytes."""
SIMULATOR_MEMORY: Final = 200 << 20
"""Memory to allow for a simulator, bytes."""
PER_CORE: Final = 4
"""Simulators for each core."""
SANDBOX_MEMORY: Final = 256 << 20
"""Memory to allow for a sandbox with a model of usual size, bytes."""
_DISK_SHARE: Final = 0.05
"""A reserve of a disk is never more than this share of it."""
_LEAST_SIMULATORS: Final = 16
"""Simulators on a machine of few processors: most agents think for longer than a simulator drives."""


class Machine:
    """This machine, as far as this process may use it."""

    def __init__(self, proc: Path = _PROC, cgroups: Path = _CGROUPS) -> None:
        """Create it."""
        self._proc = proc
        self._cgroups = cgroups

    def processors(self) -> int:
        """Return how many processors this process may keep busy, at least 1. A part of a processor does not count."""
        counts = [len(os.sched_getaffinity(0))]
        for group in self._groups():
            quota, period = (_read(group / "cpu.max") or "max 1").split()
            if quota != "max":
                counts.append(int(quota) // int(period))
        return max(1, min(counts))

    def memory(self) -> int:
        """Return the memory that this process and its children may use in all, bytes; 0 if the kernel does not tell."""
        limits = [limit for group in self._groups() if (limit := _limit(group))]
        return min(filter(None, (self._meminfo("MemTotal"), *limits)), default=0)

    def available_memory(self) -> int:
        """Return the memory that new processes can use, bytes; 0 if the kernel does not tell."""
        available = self._meminfo("MemAvailable")
        left = [max(1, limit - _used(group)) for group in self._groups() if (limit := _limit(group))]
        return min(filter(None, (available, *left)), default=0)

    def simulators(self, sandboxes: int = 0) -> int:
        """Return how many simulators to run: four for each processor, at least 16, as far as the memory is enough.

        The service itself, a spare simulator and so many sandboxes need memory too.
        """
        wanted = max(_LEAST_SIMULATORS, PER_CORE * self.processors())
        memory = self.memory()
        if not memory:
            return wanted
        room = memory - _SERVICE - sandboxes * SANDBOX_MEMORY
        return max(1, min(wanted, room // SIMULATOR_MEMORY - 1))

    def gateway(self) -> str | None:
        """Return the IPv4 address of the default gateway, which in a container is its host; None if there is none."""
        for line in (_read(self._proc / "net/route") or "").splitlines()[1:]:
            _, destination, gateway, *_ = line.split()
            if int(destination, 16) == 0 and int(gateway, 16) != 0:
                return socket.inet_ntoa(bytes.fromhex(gateway)[::-1])
        return None

    def _groups(self) -> Iterator[Path]:
        """Yield the folders of this process's cgroup and of those above it, as far as they show."""
        found = re.search(r"^0::(.*)$", _read(self._proc / "self/cgroup") or "", re.MULTILINE)
        path = Path(found[1].lstrip("/")) if found is not None else Path()
        # A container may not see the path that the machine has for it; then its own cgroup is the root.
        for part in (path, *path.parents) if path.parts else (path,):
            if (self._cgroups / part).is_dir():
                yield self._cgroups / part

    def _meminfo(self, name: str) -> int:
        match = re.search(rf"^{name}:\s+(\d+) kB", _read(self._proc / "meminfo") or "", re.MULTILINE)
        return 1024 * int(match[1]) if match else 0


def check_disk(folder: Path, reserve: int, size: int = 0) -> None:
    """Check that so many bytes more leave a reserve of a folder's disk free, or 5 % of the disk if that is less.

    Raises OSError (ENOSPC).
    """
    disk = shutil.disk_usage(folder)
    reserve = min(reserve, int(disk.total * _DISK_SHARE))
    if disk.free - size < reserve:
        raise OSError(errno.ENOSPC, f"{disk.free} bytes are free, {size} are needed, {reserve} are kept free")


def _limit(group: Path) -> int:
    """Return a cgroup's limit on memory, bytes; 0 if it has none."""
    told = _read(group / "memory.max") or "max"
    return 0 if told == "max" else int(told)


def _used(group: Path) -> int:
    """Return the memory that a cgroup uses, bytes, without files that the kernel would give up first."""
    told = dict(line.split() for line in (_read(group / "memory.stat") or "").splitlines())
    return int(_read(group / "memory.current") or 0) - int(told.get("inactive_file") or 0)


def _read(file: Path) -> str | None:
    try:
        return file.read_text("ascii").strip()
    except OSError:
        return None
