"""Cars by which an encoder learns to see before it drives: they start anywhere, off the lane and askew."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wrongturn_agents.training.cars import cruises, training_cars
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch


def wandering_cars(config: DrivesConfig, device: torch.device, *, threads: int, **journeys: float) -> DrivingVecEnv:
    """Make such cars, which see ``rgb`` and ``segmentation``.

    If the config has traffic, all drives have the most of it: the policy cannot see what a frozen encoder never saw.

    Args:
        config: number of cars, and traffic.
        device: device of the pictures.
        threads: threads that share the simulation.
        journeys: further options of the drives, such as ``time_limit``.
    """
    options: dict[str, Any] = cruises(config)
    options["journeys"] = {"near_bends": 0.25, "near_junctions": 0.4, "lateral": 0.7, "yaw": 0.2, **journeys}
    # A stopwatch of the GPU would wait after each step, and learning could not continue meanwhile.
    watch = Stopwatch(torch.device("cpu"))
    return training_cars(
        None, device, settings=config, keys=("rgb", "segmentation"), threads=threads, stopwatch=watch,
        **{**options, "track": "segmentation"},
    )  # fmt: skip


def wander(random: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Draw actions (count, 2) with which such cars drive about: steer and accelerate."""
    return np.stack([random.normal(0.0, 0.2, count), random.uniform(-0.2, 0.8, count)], -1)


class Pool:
    """The newest rows of several tensors, on the device: a new row replaces the oldest."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._kept: dict[str, Tensor] = {}
        self.added = 0
        """Number of rows so far, with those that are gone."""

    def __len__(self) -> int:
        return min(self.added, self._size)

    def add(self, rows: dict[str, Tensor]) -> None:
        """Add rows (n, ...) of each tensor in the place of the oldest."""
        count = len(next(iter(rows.values())))
        for name, given in rows.items():
            if name not in self._kept:
                self._kept[name] = torch.empty((self._size, *given.shape[1:]), dtype=given.dtype, device=given.device)
            places = (torch.arange(count, device=given.device) + self.added) % self._size
            self._kept[name][places] = given
        self.added += count

    def draw(self, count: int) -> dict[str, Tensor]:
        """Return rows at random, from the device's torch generator."""
        device = next(iter(self._kept.values())).device
        rows = torch.randint(len(self), (count,), device=device)
        return {name: kept[rows] for name, kept in self._kept.items()}
