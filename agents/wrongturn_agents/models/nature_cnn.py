"""The small encoder of Mnih et al., "Human-level control through deep reinforcement learning" (2015)."""

import math

import torch
from torch import Tensor, nn

from wrongturn_protocol.observations import IMAGE_SHAPE


class NatureCNN(nn.Module):
    """Three convolutions and a linear layer, with the sizes that Stable-Baselines3 uses.

    The input is (B, ``channels``, 64, 192), the output (B, ``features``).
    """

    def __init__(self, channels: int, features: int = 512, widths: tuple[int, int, int] = (32, 64, 64)) -> None:
        super().__init__()
        first, second, third = widths
        self.convolutions = nn.Sequential(
            nn.Conv2d(channels, first, kernel_size=8, stride=4),
            nn.ReLU(),
            nn.Conv2d(first, second, kernel_size=4, stride=2),
            nn.ReLU(),
            nn.Conv2d(second, third, kernel_size=3, stride=1),
            nn.ReLU(),
            nn.Flatten(),
        )
        with torch.no_grad():
            width = self.convolutions(torch.zeros(1, channels, *IMAGE_SHAPE)).shape[1]
        self.linear = nn.Sequential(nn.Linear(width, features), nn.ReLU())
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                nn.init.orthogonal_(module.weight, math.sqrt(2))
                nn.init.zeros_(module.bias)  # type: ignore[arg-type]

    def forward(self, picture: Tensor) -> Tensor:
        """Encode pictures (B, ``channels``, 64, 192) as (B, ``features``)."""
        encoded: Tensor = self.linear(self.convolutions(picture))
        return encoded
