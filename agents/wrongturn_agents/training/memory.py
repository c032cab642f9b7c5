"""Errors for runs that need more memory than their device has."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import torch

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import Settings

PIXELS: Final = 64 * 192
_SHORT: Final = "option num_envs: there is not memory enough; give a smaller --num-envs, or fewer by --option"


@contextmanager
def memory_named(settings: Settings, device: torch.device) -> Iterator[None]:
    """Report a lack of memory in words, before the system ends the process.

    Args:
        settings: settings of the run.
        device: device of the run, which keeps its decisions and pictures.
    """
    there = memory_of(device)
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


def memory_of(device: torch.device) -> int:
    """Return the bytes of memory that a run may use: all of this machine's, or what is free on a GPU."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
