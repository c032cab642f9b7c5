"""The newest pictures of each car, one behind the other."""

import torch
from torch import Tensor

from wrongturn_agents.models.marln import FRAMES


class FrameStack:
    """Keeps the last four pictures of each car. At a drive's start the first one stands for those before it."""

    def __init__(self) -> None:
        self._frames: Tensor | None = None

    def push(self, rgb: Tensor, begun: Tensor) -> Tensor:
        """Return the stacks (n, 4, 64, 192, 3) uint8, the newest last; the next call overwrites them.

        Args:
            rgb: (n, 64, 192, 3) uint8.
            begun: (n,) bool: whether the picture is the first of a drive.
        """
        again = rgb.unsqueeze(1).expand(-1, FRAMES, -1, -1, -1)
        if self._frames is None:
            self._frames = again.clone()
            return self._frames
        self._frames = torch.cat([self._frames[:, 1:], rgb.unsqueeze(1)], 1)
        rows = begun.nonzero().squeeze(1)
        self._frames[rows] = again[rows]
        return self._frames
