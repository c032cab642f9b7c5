"""Finds the files that a guest needs to run: the interpreter, its libraries and a few packages, and nothing else."""

import functools
import importlib.util
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Final

from wrongturn_sandbox.confinement import SECCOMP_LIBRARY, load_seccomp
from wrongturn_sandbox.errors import SandboxUnavailableError

PACKAGES: Final = (
    "wrongturn_sandbox",
    "numpy",
    "onnx",
    "onnxruntime",
    "msgpack",
    "ml_dtypes",
    "google.protobuf",
    "google._upb",
    "typing_extensions",
    "pyseccomp",
)
"""The packages that a guest imports."""
_NATIVE: Final = ("numpy/_core", "numpy/linalg", "onnx", "onnxruntime/capi", "msgpack", "ml_dtypes", "google/_upb")
_NEEDED: Final = re.compile(r"^\s*[^/\s]\S* => (/\S+)", re.MULTILINE)
_LINKER: Final = re.compile(r"^\s*(/\S+)", re.MULTILINE)


@functools.cache
def interpreter() -> Path:
    """Return the interpreter itself, not the link of a virtual environment."""
    return Path(getattr(sys, "_base_executable", None) or sys.executable).resolve()


@functools.cache
def standard_library() -> dict[str, Path]:
    """Return the folders of Python's standard library, by their place below the interpreter's prefix."""
    version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    folders = {f"{lib}/{version}": Path(sys.base_prefix, lib, version) for lib in ("lib", sys.platlibdir)}
    folders[f"{sys.platlibdir}/{version}"] = Path(sysconfig.get_path("stdlib"))
    return {
        place: path for place, path in folders.items() if (path / "os.py").exists() or (path / "lib-dynload").exists()
    }


@functools.cache
def packages() -> dict[str, Path]:
    """Return where each file or folder of the packages is, by its place below one folder.

    Raises SandboxUnavailableError if a package is not installed.
    """
    found: dict[str, Path] = {}
    for name in PACKAGES:
        place = name.replace(".", "/")
        try:
            spec = importlib.util.find_spec(name)
        except ImportError:
            spec = None
        if spec is None:
            raise SandboxUnavailableError(
                f"Python package {name.partition('.')[0]} is missing; install the service's requirements again"
            )
        if spec.submodule_search_locations:
            folder = Path(next(iter(spec.submodule_search_locations)))
            found[place] = folder
            if (folder.parent / f"{name}.libs").is_dir():
                found[f"{place}.libs"] = folder.parent / f"{name}.libs"
        elif spec.origin is not None:
            found[f"{place}.py"] = Path(spec.origin)
            if spec.cached is not None and Path(spec.cached).is_file():
                found[f"__pycache__/{Path(spec.cached).name}"] = Path(spec.cached)
    return found


@functools.cache
def shared_libraries() -> tuple[Path, tuple[Path, ...]]:
    """Return the path where programs expect the dynamic linker, and the shared libraries that it would load.

    Raises SandboxUnavailableError if libseccomp is missing, or the linker cannot be asked.
    """
    try:
        load_seccomp()
    except OSError as error:
        raise SandboxUnavailableError(str(error.strerror)) from None
    mapped = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    linker = re.search(r"(/\S*/ld-[^/\s]+\.so[^/\s]*)$", mapped, re.MULTILINE)
    seccomp = re.search(r"(/\S*)/libseccomp\.so[^/\s]*$", mapped, re.MULTILINE)
    if linker is None or seccomp is None:
        raise SandboxUnavailableError("cannot find the system's dynamic linker; the sandbox needs Linux with glibc")
    expected = Path(linker[1])
    found = {Path(seccomp[1], SECCOMP_LIBRARY)}
    for program in _programs():
        command = [linker[1], "--list", str(program)]
        listed = subprocess.run(command, capture_output=True, text=True, check=False, env={}).stdout  # noqa: S603 - our files
        found |= {Path(path) for path in _NEEDED.findall(listed)}
        if program == interpreter() and (named := _LINKER.search(listed)):
            expected = Path(named[1])
    own = tuple(path.resolve() for path in packages().values())
    return expected, tuple(sorted(path for path in found if not any(path.resolve().is_relative_to(at) for at in own)))


def _programs() -> list[Path]:
    """Return the programs and libraries that the guest runs, whose own needs are asked for."""
    places = packages()
    found = [
        interpreter(),
        *(file for path in standard_library().values() for file in path.glob("lib-dynload/_ctypes.*")),
    ]
    for native in _NATIVE:
        package, _, below = native.partition("/")
        folder = places[native] if native in places else places[package] / below
        found += sorted(folder.glob("*.so*"))
    return found
