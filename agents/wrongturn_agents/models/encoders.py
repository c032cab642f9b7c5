"""What the three agents see with: encoders of one image of the observation."""

import copy
from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from wrongturn_agents.models.augmentation import Augmentation, AugmentationConfig
from wrongturn_agents.models.inputs import CLASSES, Observation, encoding_dtype, one_hot, planes, wanted
from wrongturn_agents.models.linknet import LinkNetDecoder
from wrongturn_agents.models.masked_classes import MaskedClasses
from wrongturn_agents.models.nature_cnn import NatureCNN
from wrongturn_agents.models.resnet import WIDTHS, ResNet34, updated_statistics

FEATURES = 512
"""Width of a picture's features."""
_DEEP = WIDTHS[-1] * 2 * 6


class Encoder(nn.Module, ABC):
    """The part of an agent that sees.

    Attributes:
        width: numbers that :meth:`forward` returns for a picture.
    """

    width = FEATURES

    def disturb(self, observation: Observation, generator: torch.Generator | None = None) -> Observation:  # noqa: ARG002
        """Return the observation with its image changed at random, for training."""
        return observation

    @abstractmethod
    def forward(self, observation: Observation) -> Tensor:
        """Encode (B, 64, 192[, 3]) as (B, ``width``), in autocast's dtype."""

    def project(self, encoded: Tensor) -> Tensor:
        """Turn the encoding (B, ``width``) into features (B, 512) float32, by layers that PPO trains."""
        return encoded

    def segmentation_logits(self, observation: Observation) -> Tensor:  # noqa: ARG002 - here it is refused
        """Return logits (B, 11, 64, 192) of each pixel's class."""
        raise ValueError(f"{type(self).__name__}: it is given the segmentation and tells none; ask another agent")

    def update_statistics(self, observation: Observation) -> None:
        """Update batch normalisation with a batch, if there is any."""


class SegmentationEncoder(Encoder):
    """NatureCNN on one-hot segmentation."""

    def __init__(self, masked_classes: float = 0.0) -> None:
        super().__init__()
        self.mask = MaskedClasses(masked_classes)
        self.network = NatureCNN(CLASSES, FEATURES)

    def disturb(self, observation: Observation, generator: torch.Generator | None = None) -> Observation:
        """Hide classes, if that was asked for."""
        if self.mask.probability == 0.0:
            return observation
        return {**observation, "segmentation": self.mask(wanted(observation, "segmentation"), generator)}

    def forward(self, observation: Observation) -> Tensor:
        """Encode ``segmentation`` (B, 64, 192) as (B, 512)."""
        dtype = encoding_dtype(self.network.linear[0].weight)  # type: ignore[arg-type]
        encoded: Tensor = self.network(one_hot(wanted(observation, "segmentation"), dtype))
        return encoded


class PictureEncoder(Encoder):
    """ResNet-34 on RGB, with a decoder from which it learns segmentation.

    Args:
        augmentation: how much pictures are changed in training.
    """

    width = _DEEP

    def __init__(self, augmentation: AugmentationConfig | None = None) -> None:
        super().__init__()
        self.augmentation = Augmentation(augmentation)
        self.network = ResNet34()
        self.decoder = LinkNetDecoder()
        self.projection = nn.Sequential(nn.LayerNorm(_DEEP), nn.Linear(_DEEP, FEATURES), nn.ReLU())

    def disturb(self, observation: Observation, generator: torch.Generator | None = None) -> Observation:
        """Change the picture; the segmentation stays."""
        return {**observation, "rgb": self.augmentation(wanted(observation, "rgb"), generator)}

    def forward(self, observation: Observation) -> Tensor:
        """Encode ``rgb`` (B, 64, 192, 3) as (B, 6144)."""
        encoded: Tensor = self.network(self.planes(observation)).flatten(1)
        return encoded

    def project(self, encoded: Tensor) -> Tensor:
        """Project (B, 6144) to (B, 512)."""
        projected: Tensor = self.projection(encoded)
        return projected

    def planes(self, observation: Observation) -> Tensor:
        """Return the picture as the ResNet's input, (B, 3, 64, 192)."""
        return planes(wanted(observation, "rgb"), encoding_dtype(next(self.network.parameters())))


class ImageEncoder(PictureEncoder):
    """ResNet-34 that learns segmentation first, through a decoder without links, and is then frozen.

    Args:
        augmentation: how much pictures are changed in training.
    """

    def __init__(self, *, frozen: bool = True, augmentation: AugmentationConfig | None = None) -> None:
        super().__init__(augmentation)
        self.freeze(frozen)

    def freeze(self, frozen: bool = True) -> None:
        """Freeze or unfreeze the ResNet and its decoder."""
        self.frozen = frozen
        self.network.requires_grad_(not frozen)
        self.decoder.requires_grad_(not frozen)

    def segmentation_logits(self, observation: Observation) -> Tensor:
        """Return logits (B, 11, 64, 192). In training mode batch normalisation learns, unless it is frozen."""
        with updated_statistics(self.network, updated=self.training and not self.frozen):
            deep = self.network(self.planes(observation))
        logits: Tensor = self.decoder(deep)
        return logits

    @torch.no_grad()
    def update_statistics(self, observation: Observation) -> None:
        """Update batch normalisation with a batch, unless it is frozen."""
        with updated_statistics(self.network, updated=not self.frozen):
            self.network(self.planes(observation))


class AuxiliaryEncoder(PictureEncoder):
    """ResNet-34 with its last stage twice, for driving and for segmentation, and a decoder with links.

    Args:
        augmentation: how much pictures are changed in training.
    """

    def __init__(self, *, augmentation: AugmentationConfig | None = None) -> None:
        super().__init__(augmentation)
        self.segmenting: nn.Module = copy.deepcopy(self.network.stages[3])
        self.segmenting.train()

    def segmentation_logits(self, observation: Observation) -> Tensor:
        """Return logits (B, 11, 64, 192) by the shared stages and segmentation's own.

        In training mode batch normalisation learns, and so do the driving stage's statistics: nothing else updates
        them.
        """
        with updated_statistics(self.network, updated=self.training):
            stem, first, second, third = self.network.shared(self.planes(observation))
            if self.training:
                with torch.no_grad():
                    self.network.stages[3](third)
        logits: Tensor = self.decoder(self.segmenting(third), (third, second, first, stem))
        return logits

    @torch.no_grad()
    def update_statistics(self, observation: Observation) -> None:
        """Update batch normalisation on the driving path with a batch."""
        with updated_statistics(self.network):
            self.network(self.planes(observation))
