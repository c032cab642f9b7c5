"""What MaRLn's encoder learns to tell before it drives: six classes of pixels, and where the car is on its road."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_agents.models.inputs import CLASSES
from wrongturn_agents.models.linknet import LinkNetDecoder
from wrongturn_protocol.segmentation import SegmentationClass

FARTHEST: Final = 30.0
"""A junction that is farther away is told as this far, metres."""
GROUPS: Final[Mapping[str, tuple[SegmentationClass, ...]]] = {
    "moving": (SegmentationClass.VEHICLE, SegmentationClass.PEDESTRIAN),
    "marking": (SegmentationClass.LANE_MARKING,),
    "road": (SegmentationClass.ROAD,),
    "sidewalk": (SegmentationClass.SIDEWALK,),
    "sky": (SegmentationClass.SKY,),
    "background": (
        *(SegmentationClass.VOID, SegmentationClass.VEGETATION, SegmentationClass.BUILDING),
        *(SegmentationClass.WALL, SegmentationClass.TRAFFIC_SIGN),
    ),
}
"""The six classes. The paper has traffic lights instead of the sky; our towns have none."""
_HIDDEN: Final = 256
_SCALES: Final = (10.0, 0.5, 0.1)
"""Metres to the junction, metres beside the lane and radians to the lane that count as an error of 1."""


class Affordances(NamedTuple):
    """Where cars are on their roads."""

    inside: Tensor
    """(B,): 1 within a junction, else 0."""
    distance: Tensor
    """(B,): metres to the stop line, 0 within a junction, FARTHEST where none is nearer."""
    lateral: Tensor
    """(B,): metres to the left of the lane's centre."""
    angle: Tensor
    """(B,): heading to the left of the lane's, radians."""


class AffordanceHeads(nn.Module):
    """Tells classes and affordances from an encoding; only pretraining needs it."""

    groups: Tensor

    def __init__(self, deep: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.decoder = LinkNetDecoder(widths, len(GROUPS))
        self.told = nn.Sequential(nn.LayerNorm(deep), nn.Linear(deep, _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, 4))
        table = torch.zeros(CLASSES, dtype=torch.int64)
        for number, classes in enumerate(GROUPS.values()):
            table[list(classes)] = number
        self.register_buffer("groups", table, persistent=False)

    def tell(self, encoded: Tensor) -> Affordances:
        """Return affordances of (B, C, 2, 6); ``inside`` as a logit."""
        inside, *measured = self.told(encoded.flatten(1).float()).unbind(1)
        return Affordances(inside, *(number * scale for number, scale in zip(measured, _SCALES, strict=True)))

    def loss(self, encoded: Tensor, segmentation: Tensor, truth: Affordances) -> Tensor:
        """Return the sum of the losses of encodings (B, C, 2, 6), by the newest pictures' truth.

        Their segmentation is (B, 64, 192) uint8. Beside and to the lane count only outside junctions: within one there
        is a lane for each exit.
        """
        wanted = self.groups[segmentation.long()]
        classes = functional.cross_entropy(self.decoder(encoded).float(), wanted)
        told = self.tell(encoded)
        inside = functional.binary_cross_entropy_with_logits(told.inside, truth.inside)
        outside = 1.0 - truth.inside
        distance, lateral, angle = (
            functional.smooth_l1_loss(found / scale, real / scale, reduction="none")
            for found, real, scale in zip(told[1:], truth[1:], _SCALES, strict=True)
        )
        lane = ((lateral + angle) * outside).sum() / outside.sum().clamp_min(1.0)
        return classes + inside + distance.mean() + lane
