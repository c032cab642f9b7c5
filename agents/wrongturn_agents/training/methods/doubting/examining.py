"""How right a network is about pictures that it did not learn from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch

from wrongturn_agents.models.doubt import Doubt
from wrongturn_agents.training.methods.doubting.frames import FrameSource
from wrongturn_networks import Town

_HELD_OUT_SEED: Final = 9_001
_NEAR: Final = (5.0, 16.0)


@dataclass(frozen=True)
class HeldOutAccuracy:
    """Accuracy on held-out pictures."""

    exits: float
    """Share of right exits from 5 to 16 m before stop lines."""
    approaches: float
    """Share of pictures there with all three exits right."""
    distance: float
    """Mean error of the distance there, metres."""
    inside: float
    """Share of pictures that are rightly told to be nearer or farther than 2 m from the stop line."""


@torch.inference_mode()
def examine(model: Doubt, towns: Sequence[Town], *, pictures: int = 4096, threads: int = 1) -> HeldOutAccuracy:
    """Return how right a network is about pictures of some towns, drawn equally often."""
    device = next(model.parameters()).device
    share = 1.0 / len(towns)
    source = FrameSource(towns, _HELD_OUT_SEED, first_share=share, device=device, threads=threads)
    right, whole, error, near, sided, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    while total < pictures:
        frames = source.draw(512)
        exits, distance = (part.float() for part in model.tell(frames.observation))
        at = (frames.distance > _NEAR[0]) & (frames.distance <= _NEAR[1])
        same = ((exits > 0) == (frames.exits > 0.5))[at]
        right += same.float().mean(1).sum().item()
        whole += same.all(1).float().sum().item()
        error += (distance[:, 0] - frames.distance).abs()[at].sum().item()
        near += at.float().sum().item()
        sided += ((distance[:, 0] > 2.0) == (frames.distance > 2.0)).float().sum().item()
        total += len(frames.distance)
    return HeldOutAccuracy(right / near, whole / near, error / near, sided / total)
