"""The device that a training or a scoring computes on, its threads and its memory."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import torch

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import Settings

_SHORT: Final = "option num_envs: there is not memory enough; give a smaller --num-envs, or fewer by --option"
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


@contextmanager
def memory_named(settings: Settings, device: torch.device) -> Iterator[None]:
    """Report in words that a device lacks the memory for a run's decisions and pictures, before the system kills it."""
    if device.type == "cuda":
        there = torch.cuda.mem_get_info(device)[0]
    else:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for option, wanted, what in settings.memory():
        if wanted > there:
            raise TrainingError(
                f"option {option}: {getattr(settings, option)} {what} need {wanted / 2**30:,.0f} GiB, and there are "
                f"{there / 2**30:,.0f}; give fewer, or a smaller size of what is kept or learned from by --option"
            )
    try:
        yield
    except (MemoryError, torch.OutOfMemoryError) as error:
        raise TrainingError(_SHORT) from error
    except RuntimeError as error:
        if "allocate memory" not in str(error):  # wording of torch's allocator on the CPU
            raise
        raise TrainingError(_SHORT) from error
