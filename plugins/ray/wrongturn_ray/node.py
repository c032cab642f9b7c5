"""What runs on a node: a task of Ray that starts one program, waits for it, and tells how it ended.

Ray carries this module to the node as it is, so that a node without the package can say so. It may import the standard
library only.
"""

import contextlib
import os
import platform
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, Any, Final

_KEPT: Final = 8 * 1024
"""Bytes of the last words that are kept."""
_LAUNCH: Final = """
import ctypes, os, sys
ctypes.CDLL(None).prctl(1, 9)
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""
"""Becomes the program, which the kernel kills when Ray's worker ends. By then the worker may have ended already."""


def versions() -> dict[str, str]:
    """Return the versions that have to be the same on the service's machine and on all nodes."""
    try:
        package = version("wrongturn-ray")
    except PackageNotFoundError:
        package = "none"
    return {"Python": ".".join(platform.python_version_tuple()[:2]), "wrongturn-ray": package}


def run(
    command: Sequence[str], environment: Mapping[str, str], files: Mapping[str, bytes], wanted: Mapping[str, str]
) -> dict[str, Any]:
    """Run a program until it ends; return its status, its last words and the node's name.

    ``command`` are the arguments of Python. The program runs in a folder of its own, which holds the ``files``; so can
    its children that inherit its descriptors.
    ``environment`` is added to that of the node. ``why`` says why it was not started: the node has other versions than
    ``wanted``.
    """
    node, found = socket.gethostname(), versions()
    if found != dict(wanted):
        has, wants = (", ".join(f"{name} {number}" for name, number in each.items()) for each in (found, wanted))
        why = f"node {node} has {has}, but the service {wants}; install the same versions on all nodes"
        return {"status": None, "words": "", "node": node, "why": why}
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="wrongturn-", ignore_cleanup_errors=True))
        # A file has no name on the disk, so nothing is left of a stranger's model when this process is killed.
        held = [stack.enter_context(tempfile.TemporaryFile()) for _ in files]
        for file, (name, content) in zip(held, files.items(), strict=True):
            file.write(content)
            file.flush()
            Path(folder, name).symlink_to(f"/proc/self/fd/{file.fileno()}")
        process = subprocess.Popen(  # noqa: S603 - a program of ours
            [sys.executable, "-I", "-S", "-c", _LAUNCH, str(os.getpid()), sys.executable, *command],
            cwd=folder,
            env={**os.environ, **environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=[file.fileno() for file in held],
            start_new_session=True,
        )
        assert process.stdout is not None
        words = bytearray()
        reader = threading.Thread(target=_keep, args=(process.stdout, words), daemon=True)
        reader.start()
        status = process.wait()
        with contextlib.suppress(ProcessLookupError):  # what is left of its group
            os.killpg(process.pid, signal.SIGKILL)
        reader.join(1.0)  # a process that left the group may hold the pipe open
        if not reader.is_alive():
            process.stdout.close()
    return {"status": status, "words": bytes(words).decode(errors="replace"), "node": node, "why": None}


def _keep(pipe: IO[bytes], words: bytearray) -> None:
    while part := os.read(pipe.fileno(), _KEPT):
        words += part
        del words[:-_KEPT]
