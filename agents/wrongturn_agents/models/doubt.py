"""What ``doubting`` sees: how far the next junction is, and which exits it has, from one picture."""

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.encoders import MaskedClasses
from wrongturn_agents.models.inputs import Observation, encoding_dtype, planes, wanted
from wrongturn_protocol.segmentation import SegmentationClass

FARTHEST: Final = 40.0
"""Distances to a stop line are told up to this, metres."""
MARKS: Final = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 23.0, 26.0, 30.0, 35.0)
"""The network tells of each of these distances, metres, whether the stop line is farther."""
LINE: Final = 6.0
"""Nearer to the stop line than this, metres, a car without a direction has missed its command. One of the marks."""
_WIDTHS: Final = (24, 48, 64, 96)
_HIDDEN: Final = 192

_PLANES: Final = (
    (SegmentationClass.ROAD, SegmentationClass.LANE_MARKING),
    (SegmentationClass.LANE_MARKING,),
    (SegmentationClass.SIDEWALK,),
    (SegmentationClass.VEGETATION,),
    (SegmentationClass.BUILDING, SegmentationClass.WALL),
)
"""Classes that share a plane of the input; the others show no road."""


class Doubt(nn.Module):
    """A small network that tells from one picture, ``rgb`` or ``segmentation``, what the road ahead offers."""

    steps: Tensor
    classes: Tensor

    def __init__(self, key: str, *, augment: bool = True, masked_classes: float = 0.0) -> None:
        super().__init__()
        self.key = key
        self.augmentation = Augmentation() if augment else None
        self.mask = MaskedClasses(masked_classes)
        layers: list[nn.Module] = []
        channels, kernel = 3 if key == "rgb" else len(_PLANES), 5
        for width in _WIDTHS:
            layers += [
                nn.Conv2d(channels, width, kernel, stride=2, padding=kernel // 2, bias=False),
                nn.BatchNorm2d(width),
                nn.ReLU(),
            ]
            channels, kernel = width, 3
        self.convolutions = nn.Sequential(*layers, nn.Flatten())
        self.head = nn.Sequential(
            nn.Linear(channels * 4 * 12, _HIDDEN), nn.ReLU(), nn.Dropout(0.2), nn.Linear(_HIDDEN, 3 + len(MARKS))
        )
        ends = torch.tensor((*MARKS, FARTHEST))
        self.register_buffer("steps", ends.diff(), persistent=False)
        table = torch.zeros(len(SegmentationClass), len(_PLANES))
        for plane, classes in enumerate(_PLANES):
            table[list(classes), plane] = 1.0
        self.register_buffer("classes", table, persistent=False)

    def forward(self, observation: Observation) -> tuple[Tensor, Tensor]:
        """Return logits of the exits (B, 3): left, right, straight; and of "farther than" each mark (B, marks)."""
        picture = wanted(observation, self.key)
        dtype = encoding_dtype(self.convolutions[0].weight)  # type: ignore[arg-type]
        if self.key == "rgb":
            seen = planes(picture, dtype)
        else:
            seen = functional.embedding(picture.int(), self.classes.to(dtype)).permute(0, 3, 1, 2)
        both: Tensor = self.head(self.convolutions(seen)).float()
        return both[:, :3], both[:, 3:]

    def disturb(self, observation: Observation) -> Observation:
        """Change pictures at random, so that the network learns what does not depend on the changes."""
        if self.key == "segmentation":
            return {**observation, "segmentation": self.mask(wanted(observation, "segmentation"))}
        return (
            observation if self.augmentation is None else {**observation, "rgb": self.augmentation(observation["rgb"])}
        )

    def metres(self, beyond: Tensor) -> Tensor:
        """Return the expected distance to the stop line (B, 1), metres, of the logits of the marks."""
        return (torch.sigmoid(beyond) * self.steps).sum(1, keepdim=True)

    def tell(self, observation: Observation) -> tuple[Tensor, Tensor]:
        """Return logits of the exits (B, 3), and the expected distance to the stop line (B, 1), metres."""
        exits, beyond = self(observation)
        return exits, self.metres(beyond)

    def loss(self, observation: Observation, distance: Tensor, exits: Tensor, shown: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean cross-entropies of exits, (B, 3) of 0 and 1, where ``shown`` (B,) is 1, and of marks."""
        told, beyond = self(observation)
        marks = torch.tensor(MARKS, device=distance.device)
        truth = (distance[:, None] > marks).float()
        about_exits = functional.binary_cross_entropy_with_logits(told, exits, reduction="none").sum(1)
        about_marks = functional.binary_cross_entropy_with_logits(beyond, truth, reduction="none").mean(1)
        return (about_exits * shown).sum() / shown.sum().clamp_min(1.0), about_marks.mean()
