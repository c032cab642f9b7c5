"""Program for the inside of a sandbox: tries what a hostile model would, and tells the host what worked.

The first argument is JSON with ``socket``, ``confine``, ``files`` and ``folder``.
"""

import contextlib
import ctypes
import json
import mmap
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from wrongturn_sandbox import confinement

GIVEN = json.loads(sys.argv[1])
PARENT = os.getppid()
LIBC = ctypes.CDLL(None, use_errno=True)


def attempt(action: Callable[[], Any]) -> Any:
    """Return what an action gives, or "no" where it is refused."""
    try:
        given = action()
    except (OSError, RuntimeError, MemoryError, ValueError):
        return "no"
    return True if given is None else given


def call(name: str, *arguments: Any) -> None:
    """Call a function of the C library that says -1 when it fails."""
    if getattr(LIBC, name)(*arguments) == -1:
        raise OSError(ctypes.get_errno(), name)


def read(path: str) -> str:
    if Path(path).is_dir():
        return repr(list(Path(path).iterdir()))
    with Path(path).open("rb") as file:
        return repr(file.read(100))


def write(folder: str) -> None:
    Path(folder, "left-behind").write_text("x", encoding="utf-8")


def connect(family: int, kind: int, address: Any) -> None:
    with socket.socket(family, kind) as made:
        made.connect(address)


def fork() -> None:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


def start() -> None:
    subprocess.run([sys.executable, "-c", ""], check=True)


def processes() -> list[int]:
    with contextlib.suppress(OSError):
        names = [entry.name for entry in Path("/proc").iterdir()]
        return [int(name) for name in names if name.isdigit() and int(name) != os.getpid()]
    return []


def capabilities() -> int:
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)
    data = (ctypes.c_uint32 * 6)()
    call("capget", header, data)
    return int(data[0]) | int(data[3])


def run_code() -> None:
    mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_EXEC).close()


def thread() -> None:
    started = threading.Thread(target=int)
    started.start()
    started.join()


def descriptors() -> int:
    found = 0
    for number in range(64):
        with contextlib.suppress(OSError):
            os.get_inheritable(number)
            found += 1
    return found


found: dict[str, Any] = {
    "confined": GIVEN["confine"],
    "parent": PARENT,
    "environment": dict(os.environ),
    "descriptors": descriptors(),
}
confined = threading.Event()
old: list[Any] = []


def wait_and_read() -> None:
    confined.wait()
    old.append(attempt(lambda: read(os.__file__)))


old_thread = threading.Thread(target=wait_and_read)
old_thread.start()
if GIVEN["confine"]:
    confinement.confine()
confined.set()
old_thread.join()
nowhere = bytes(16)
found |= {
    "read": {path: attempt(lambda path=path: read(path)) for path in GIVEN["files"]},
    "written": {
        folder: attempt(lambda folder=folder: write(folder))
        for folder in ("/", "/tmp", "/var/tmp", "/dev/shm", "/packages", "/run", sys.prefix, GIVEN["folder"])
    },
    "sockets": {
        "internet": attempt(lambda: connect(socket.AF_INET, socket.SOCK_STREAM, ("127.0.0.1", 22))),
        "datagram": attempt(lambda: connect(socket.AF_INET, socket.SOCK_DGRAM, ("192.0.2.1", 53))),
        "local": attempt(lambda: connect(socket.AF_UNIX, socket.SOCK_STREAM, "/run/dbus/system_bus_socket")),
        "raw": attempt(lambda: connect(socket.AF_INET, socket.SOCK_RAW, ("127.0.0.1", 0))),
    },
    "killed": attempt(lambda: os.kill(PARENT, 0)),
    "traced": attempt(lambda: call("ptrace", 16, PARENT, 0, 0)) if GIVEN["confine"] else "no",
    "memory_of_parent": attempt(lambda: call("process_vm_readv", PARENT, nowhere, 1, nowhere, 1, 0)),
    "processes": attempt(processes),
    "capabilities": attempt(capabilities),
    "privileges": {
        "mount": attempt(lambda: call("mount", b"none", b"/", b"tmpfs", 0, None)),
        "root": attempt(lambda: os.setuid(0)) if os.getuid() else "no",
        "chroot": attempt(lambda: os.chroot("/")),
        "namespace": attempt(lambda: call("unshare", 0x40000000)),
        "host name": attempt(lambda: socket.sethostname("evil")),
        "priority": attempt(lambda: os.nice(-5)),
    },
    "fork": attempt(fork),
    "exec": attempt(start),
    "thread": attempt(thread),
    "old_thread": old[0],
    "code": attempt(run_code),
    "open_own": attempt(lambda: read(os.__file__)),
}
os.write(GIVEN["socket"], json.dumps(found).encode() + b"\n")
os._exit(0)
