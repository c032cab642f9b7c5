"""The network of MaRLn: a frozen ResNet-18 on four pictures, and quantile values of discrete actions.

Toromanoff et al., "End-to-end model-free reinforcement learning for urban driving using implicit affordances" (CVPR
2020).
"""

import itertools
from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor, nn

from wrongturn_agents.models.actor_critic import controls
from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.inputs import Observation, encoding_dtype, wanted
from wrongturn_agents.models.resnet import DEPTHS_18, WIDTHS, ResNet, updated_statistics
from wrongturn_marln.affordances import AffordanceHeads
from wrongturn_marln.quantiles import QuantileHeads
from wrongturn_protocol.observations import IMAGE_SHAPE

FRAMES: Final = 4
"""Pictures that the network sees: the newest, and the ones of the three decisions before."""
STEERS: Final = (-0.8, -0.5, -0.3, -0.16, -0.08, -0.03, 0.0, 0.03, 0.08, 0.16, 0.3, 0.5, 0.8)
"""Steering to choose from. It is finest about straight on, where a lane needs it."""
ACCELERATIONS: Final = (-0.6, 0.0, 0.35, 1.0)
"""Brake, or one of three positions of the throttle."""
ACTIONS: Final = tuple(itertools.product(STEERS, ACCELERATIONS))
"""Steer and accelerate of each action."""
_PICTURE: Final = (*IMAGE_SHAPE, 3)
_PIXELS: Final = IMAGE_SHAPE[0] * IMAGE_SHAPE[1] * 3
MEMORY: Final = 1 + (FRAMES - 1) * _PIXELS
"""Width of the memory: whether there were pictures before, and the three before."""
_FEATURES: Final = 512
_MEASURED: Final = 64
_SPEED: Final = 10.0  # m/s that count as 1
_QUANTILES: Final = 32


class ValueNetwork(nn.Module):
    """What learns by driving: from an encoding, speed, steering and command to the quantiles of each action's value."""

    middles: Tensor

    def __init__(self, width: int, *, hidden: int = 256, deviation: float = 0.1) -> None:
        super().__init__()
        self.projection = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, _FEATURES), nn.ReLU())
        self.measurements = nn.Sequential(nn.Linear(2, _MEASURED), nn.ReLU())
        self.heads = QuantileHeads(_FEATURES + _MEASURED, len(ACTIONS), hidden=hidden, deviation=deviation)
        middles = (torch.arange(_QUANTILES) + 0.5) / _QUANTILES
        self.register_buffer("middles", middles.unsqueeze(0), persistent=False)

    def forward(
        self, encoded: Tensor, measured: Tensor, command: Tensor, shares: Tensor, noise: Tensor | None = None
    ) -> Tensor:
        """Return quantiles (B, N, actions) at shares (B, N) in [0, 1], for an encoding (B, width).

        ``measured`` (B, 2) is speed, m/s, and steering. Without noise of its heads, weights are the mean ones.
        """
        scaled = measured * torch.tensor([1.0 / _SPEED, 1.0], device=measured.device)
        features = torch.cat([self.projection(encoded.float()), self.measurements(scaled)], 1)
        quantiles: Tensor = self.heads(features, command, shares, noise)
        return quantiles

    def choose(self, encoded: Tensor, measured: Tensor, command: Tensor, noise: Tensor | None = None) -> Tensor:
        """Return the number of each row's best action, (B,), by the mean of 32 quantiles."""
        shares = self.middles.expand(encoded.shape[0], -1)  # len() would fix the batch in an exported graph
        quantiles: Tensor = self(encoded, measured, command, shares, noise)
        return quantiles.mean(1).argmax(1)


class Marln(nn.Module):
    """The whole agent: ``hidden`` units in each stream, and noise of a first ``deviation`` that explores.

    Attributes:
        width: numbers in an encoding.
        network: the encoder.
        affordances: what the encoder learns by.
        values: what learns by driving.
    """

    table: Tensor

    def __init__(
        self,
        *,
        hidden: int = 256,
        deviation: float = 0.1,
        widths: Sequence[int] = WIDTHS,
        depths: Sequence[int] = DEPTHS_18,
    ) -> None:
        super().__init__()
        self.algorithm = "marln"
        self.width = widths[-1] * 2 * 6
        self.augmentation = Augmentation()
        self.network = ResNet(3 * FRAMES, depths, widths)
        self.affordances = AffordanceHeads(self.width, widths)
        self.values = ValueNetwork(self.width, hidden=hidden, deviation=deviation)
        self.register_buffer("table", torch.tensor(ACTIONS), persistent=False)

    def see(self, frames: Tensor) -> Tensor:
        """Return the ResNet's output (B, C, 2, 6) for pictures (B, 4, 64, 192, 3), the newest last."""
        stacked = frames.permute(0, 1, 4, 2, 3).flatten(1, 2)
        dtype = encoding_dtype(next(self.network.parameters()))
        seen: Tensor = self.network(stacked.to(dtype) * (2.0 / 255.0) - 1.0)
        return seen

    def encode(self, frames: Tensor) -> Tensor:
        """Encode pictures (B, 4, 64, 192, 3) as (B, ``width``). While the encoder is frozen, keep this instead."""
        return self.see(frames).flatten(1)

    def learn_to_see(self, frames: Tensor) -> Tensor:
        """Return :meth:`see` with batch normalisation that learns its statistics."""
        with updated_statistics(self.network):
            return self.see(frames)

    def begin(self, count: int) -> Tensor:
        """Return the memory of cars that begin, (``count``, MEMORY)."""
        return torch.zeros(count, MEMORY, device=self.table.device)

    def drive_on(self, observation: Observation, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return steer, throttle and brake (B, 3) of the best actions, and the new memory.

        The memory is zeros at the start, where the first picture stands for those before it.
        """
        rgb = wanted(observation, "rgb").to(memory.dtype).unsqueeze(1)
        before = memory[:, 1:].reshape(-1, FRAMES - 1, *_PICTURE)
        first = memory[:, :1].view(-1, 1, 1, 1, 1) < 0.5
        frames = torch.cat([torch.where(first, rgb, before), rgb], 1)
        measured = torch.cat([observation["speed"], observation["steering"]], 1)
        action = controls(self.table[self.values.choose(self.encode(frames), measured, observation["command"])])
        kept = torch.cat([torch.ones_like(memory[:, :1]), frames[:, 1:].flatten(1)], 1)
        return action, kept


def disturb(augmentation: Augmentation, frames: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Return stacks (B, N, 64, 192, 3) uint8 changed at random, all pictures of a stack alike."""
    rows, count = frames.shape[:2]
    draws = augmentation.draw(rows, frames.device, generator).repeat_interleave(count, 0)
    return augmentation.changed(frames.flatten(0, 1), draws).view(frames.shape)
