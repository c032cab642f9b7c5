"""Starts a program under bubblewrap: without network, files, other processes and privileges."""

import os
import shutil
import socket
import subprocess
from typing import Final

from wrongturn_sandbox.errors import SandboxUnavailableError
from wrongturn_sandbox.gpu import cuda_libraries, devices, driver_libraries
from wrongturn_sandbox.libraries import interpreter, packages, shared_libraries, standard_library

EXPENDABLE: Final = ("/bin/sh", "-c", 'echo 800 2>/dev/null >/proc/self/oom_score_adj; exec "$@"', "sh")
"""Begin of a command line whose process the kernel ends before others if memory runs out."""
_LIBRARIES: Final = "/libraries"
_PACKAGES: Final = "/packages"
_PYTHON: Final = "/python"
_QUIET: Final = {
    "ORT_DISABLE_TELEMETRY": "1",  # it would start a thread, write files and look for its maker's servers
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",
}
_ENVIRONMENT: Final = {
    **_QUIET,
    "LANG": "C.UTF-8",
    "LD_LIBRARY_PATH": _LIBRARIES,
    "PYTHONHOME": _PYTHON,
    "PYTHONPATH": _PACKAGES,
    "PYTHONDONTWRITEBYTECODE": "1",
}
_INSTALL: Final = "install it (on Debian: apt-get install bubblewrap), or use a runner container"
_REFUSED: Final = (
    "the kernel does not let it make namespaces; allow that, or use a runner container, as containers need one"
)


def environment() -> dict[str, str]:
    """Return the environment variables of a guest without bubblewrap."""
    return {**_QUIET, "LANG": "C.UTF-8", "PYTHONDONTWRITEBYTECODE": "1"}


def program() -> str:
    """Return the path of bubblewrap. Raises SandboxUnavailableError if it is not installed."""
    found = shutil.which("bwrap")
    if found is None:
        raise SandboxUnavailableError(f"bubblewrap is missing; {_INSTALL}")
    return found


def version() -> str:
    """Return bubblewrap's name and version: ``bubblewrap 0.8.0``. Raises SandboxUnavailableError."""
    try:
        told = subprocess.run([program(), "--version"], capture_output=True, text=True, check=True, timeout=10)  # noqa: S603
    except (OSError, subprocess.SubprocessError) as error:
        raise SandboxUnavailableError(f"bubblewrap does not run ({error}); {_INSTALL}") from None
    return told.stdout.strip()


def command(python_arguments: list[str], *, gpu: bool = False) -> list[str]:
    """Return the command line that runs Python inside a sandbox. Raises SandboxUnavailableError.

    With ``gpu`` it has the GPU's devices, and the libraries of driver and CUDA.
    """
    linker, libraries = shared_libraries()
    python = f"{_PYTHON}/bin/{interpreter().name}"
    folders = {f"{_PYTHON}/{place}": path for place, path in standard_library().items()}
    binds = {python: interpreter(), str(linker): linker, **folders}
    binds |= {f"{_LIBRARIES}/{path.name}": path for path in libraries}
    binds |= {f"{_PACKAGES}/{place}": path for place, path in packages().items()}
    variables = dict(_ENVIRONMENT)
    if gpu:
        binds |= {f"{_LIBRARIES}/{path.name}": path for path in driver_libraries()}
        cuda = cuda_libraries()
        binds |= {f"{_PACKAGES}/{place}": path for place, path in cuda.items()}
        variables["LD_LIBRARY_PATH"] = ":".join((_LIBRARIES, *(f"{_PACKAGES}/{place}" for place in cuda)))
        variables |= {name: os.environ[name] for name in ("CUDA_VISIBLE_DEVICES",) if name in os.environ}
    arguments = [
        *("--unshare-user", "--unshare-all", "--die-with-parent", "--new-session", "--clearenv"),
        *("--cap-drop", "ALL", "--uid", "65534", "--gid", "65534", "--hostname", "sandbox"),
    ]
    for place, path in binds.items():
        arguments += ["--ro-bind", str(path), place]
    for place, path in folders.items():  # other packages of this machine may lie in the midst of the library
        for name in ("site-packages", "dist-packages"):
            if (path / name).is_dir():
                arguments += ["--tmpfs", f"{place}/{name}", "--remount-ro", f"{place}/{name}"]
    for device in devices() if gpu else ():
        arguments += ["--dev-bind", str(device), str(device)]
    for name, value in variables.items():
        arguments += ["--setenv", name, value]
    arguments += ["--chdir", "/", "--remount-ro", "/"]
    return [program(), *arguments, "--", python, "-S", "-s", "-P", *python_arguments]


class Bubblewrap:
    """A guest under bubblewrap. Raises SandboxUnavailableError if something that it needs is missing.

    The kernel ends it together with the thread that starts it. So start it in one that lives as long.
    """

    def __init__(self, *, gpu: bool = False) -> None:
        mine, theirs = socket.socketpair()
        try:
            line = [*EXPENDABLE, *command(["-m", "wrongturn_sandbox", "--guest", str(theirs.fileno())], gpu=gpu)]
            self._process = subprocess.Popen(  # noqa: S603 - the command is our own
                line,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=(theirs.fileno(),),
                env={},
            )
        except OSError as error:
            mine.close()
            raise SandboxUnavailableError(f"bubblewrap does not run ({error}); {_INSTALL}") from None
        except SandboxUnavailableError:
            mine.close()
            raise
        finally:
            theirs.close()
        self.connection = mine

    def why_not(self) -> str:
        """End the guest, and return why it did not start, for an operator."""
        self._kill()
        assert self._process.stderr is not None
        words = self._process.stderr.read(4096).decode(errors="replace").strip().splitlines()
        said = words[-1] if words else f"it ended with status {self._process.returncode}"
        hint = f"; {_REFUSED}" if "namespace" in said or "ermi" in said else ""
        return f"bubblewrap could not start the guest: {said}{hint}"

    def status(self) -> int | None:
        """Return how the guest ended, with a signal as a negative number, or None if bubblewrap itself was ended."""
        try:
            status = self._process.wait(timeout=2)
        except subprocess.TimeoutExpired:
            return None
        if status < 0:
            return None
        return 128 - status if status > 128 else status

    def _kill(self) -> None:
        self.connection.close()
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the guest now, and let go of what belonged to it."""
        self._kill()
        assert self._process.stderr is not None
        self._process.stderr.close()
