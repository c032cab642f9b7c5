"""Segmentation with hidden classes: the paper's proposal against agents that depend on a single class."""

import torch
from torch import Tensor, nn

from wrongturn_agents.models.inputs import CLASSES
from wrongturn_protocol.segmentation import SegmentationClass


class MaskedClasses(nn.Module):
    """Hides whole classes of a picture: their pixels become void. Sky is never hidden.

    Args:
        probability: probability for each class of each picture.
    """

    def __init__(self, probability: float) -> None:
        super().__init__()
        if not 0.0 <= probability <= 1.0:
            raise ValueError(f"masked_classes: {probability}; it is a probability, from 0 to 1")
        self.probability = probability

    def forward(self, segmentation: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Hide classes in pictures (B, 64, 192) uint8."""
        device = segmentation.device
        classes = torch.arange(CLASSES, device=device)
        hidden = torch.rand(len(segmentation), CLASSES, device=device, generator=generator) < self.probability
        hidden = hidden & (classes != int(SegmentationClass.SKY))
        table = torch.where(hidden, int(SegmentationClass.VOID), classes).to(segmentation.dtype)
        return table.gather(1, segmentation.flatten(1).long()).view_as(segmentation)
