"""The newest samples, on the device."""

import torch
from torch import Tensor


class Pool:
    """The newest rows of several tensors: a new row replaces the oldest."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._kept: dict[str, Tensor] = {}
        self.added = 0
        """Number of rows so far, with those that are gone."""

    def __len__(self) -> int:
        return min(self.added, self.size)

    def add(self, rows: dict[str, Tensor]) -> None:
        """Add rows (n, ...) of each tensor in the place of the oldest."""
        count = len(next(iter(rows.values())))
        for name, given in rows.items():
            if name not in self._kept:
                self._kept[name] = torch.empty((self.size, *given.shape[1:]), dtype=given.dtype, device=given.device)
            places = (torch.arange(count, device=given.device) + self.added) % self.size
            self._kept[name][places] = given
        self.added += count

    def draw(self, count: int) -> dict[str, Tensor]:
        """Return rows at random, from the device's torch generator."""
        device = next(iter(self._kept.values())).device
        rows = torch.randint(len(self), (count,), device=device)
        return {name: kept[rows] for name, kept in self._kept.items()}
