"""The device that a training or a scoring computes on."""

import os
from typing import Final

import torch

from wrongturn_agents.training.errors import TrainingError

_MOST_THREADS: Final = 1024


def device_of(name: str) -> torch.device:
    """Return the device that a user names: ``cpu``, ``cuda``, or ``auto`` for CUDA where there is some."""
    if name not in {"auto", "cpu", "cuda"}:
        raise TrainingError(f"device: is {name!r}; give auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise TrainingError("device: torch finds no CUDA device here; give cpu, or install torch for CUDA")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def check_threads(threads: int | None) -> None:
    """Check a number of threads."""
    if threads is not None and not 1 <= threads <= _MOST_THREADS:
        raise TrainingError(f"threads: is {threads}; give a whole number from 1 to {_MOST_THREADS}")


def prepare(place: torch.device, threads: int | None) -> int:
    """Prepare torch for a training on a device, and return the number of threads: all cores by default."""
    cores = threads or len(os.sched_getaffinity(0))
    if place.type == "cpu":
        torch.set_num_threads(cores)
    else:
        torch.backends.cudnn.benchmark = True  # pays off with few shapes
        torch.set_float32_matmul_precision("high")
    return cores
