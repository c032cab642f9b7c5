"""Finds what a guest needs beyond its other files to compute on an NVIDIA GPU."""

import ctypes
import re
from pathlib import Path
from typing import Final

from wrongturn_sandbox.errors import SandboxUnavailableError
from wrongturn_sandbox.libraries import packages

_DRIVER: Final = ("libcuda.so*", "libnvidia-*.so*")


def devices(folder: Path = Path("/dev")) -> list[Path]:
    """Return the devices of the driver. Raises SandboxUnavailableError if there are none."""
    found = sorted(path for path in folder.glob("nvidia*") if path.is_char_device())
    if not found:
        raise SandboxUnavailableError(f"there is no {folder}/nvidia*; install the driver, or set no share of a GPU")
    return found


def driver_libraries() -> list[Path]:
    """Return the libraries of the driver. Raises SandboxUnavailableError if they are not installed."""
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError as error:
        raise SandboxUnavailableError(f"the driver's library is missing ({error})") from None
    maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    found = re.search(r"(/\S*)/libcuda\.so[^/\s]*$", maps, re.MULTILINE)
    folder = Path(found[1] if found is not None else "/usr/lib")
    return sorted(path for pattern in _DRIVER for path in folder.glob(pattern))


def cuda_libraries() -> dict[str, Path]:
    """Return the folders of CUDA and cuDNN that pip has installed, by their place below the packages."""
    beside = packages()["onnxruntime"].parent
    return {str(path.relative_to(beside)): path for path in sorted(beside.glob("nvidia/*/lib"))}
