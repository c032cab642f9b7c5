"""Errors for runs that need more memory than their device has."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import torch

from wrongturn_agents.models.marln import FRAMES
from wrongturn_agents.training.config import PPOConfig
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.marln.config import MarlnConfig

_PIXELS: Final = 64 * 192
_BYTES: Final = {"rgb": 3 * _PIXELS, "segmentation": _PIXELS}
_FEATURES: Final = 2 * 6144
_PPO_REMEDY: Final = "give a smaller --num-envs, or fewer n_steps or frames of a minibatch by --option"
_MARLN_REMEDY: Final = "give a smaller --num-envs, or a smaller replay_size or batch_size by --option"


@contextmanager
def memory_named(config: DrivesConfig, device: torch.device) -> Iterator[None]:
    """Report a lack of memory in words, before the system ends the process.

    Args:
        config: settings of the run.
        device: device of the run, which keeps its decisions and pictures.

    Raises:
        TrainingError: what a run keeps exceeds the device's memory, or an allocation failed.
    """
    there = memory_of(device)
    remedy = _MARLN_REMEDY if isinstance(config, MarlnConfig) else _PPO_REMEDY
    replay = config.replay_size * _FEATURES if isinstance(config, MarlnConfig) else 0
    if isinstance(config, MarlnConfig) and replay > there:
        raise TrainingError(
            f"option replay_size: {config.replay_size} decisions need {replay / 2**30:,.0f} GiB, and there are "
            f"{there / 2**30:,.0f}; give fewer"
        )
    wanted = replay + _pictures(config)
    if wanted > there:
        raise TrainingError(
            f"option num_envs: {config.num_envs} egos need {wanted / 2**30:,.0f} GiB, and there are "
            f"{there / 2**30:,.0f}; {remedy}"
        )
    try:
        yield
    except (MemoryError, torch.OutOfMemoryError) as error:
        raise TrainingError(f"option num_envs: there is not memory enough; {remedy}") from error
    except RuntimeError as error:
        if "allocate memory" not in str(error):  # wording of torch's allocator on the CPU
            raise
        raise TrainingError(f"option num_envs: there is not memory enough; {remedy}") from error


def memory_of(device: torch.device) -> int:
    """Return the bytes of memory that a run may use: all of this machine's, or what is free on a GPU."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _pictures(config: DrivesConfig) -> int:
    """Return the bytes of a run's pictures or, if its encoder is frozen, of their features, about."""
    current = sum(_BYTES.values())  # each car has a current picture of each kind
    if isinstance(config, MarlnConfig):
        return config.num_envs * FRAMES * current
    assert isinstance(config, PPOConfig)
    kept = _FEATURES if config.frozen else sum(_BYTES.get(key, 0) for key in config.keys)
    return config.num_envs * (config.n_steps * kept + current)
