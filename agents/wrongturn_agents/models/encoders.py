"""What the three agents see with: encoders of one image of the observation."""

import copy
import math
from abc import ABC, abstractmethod
from typing import Final

import torch
from torch import Tensor, nn

from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.inputs import CLASSES, Observation, encoding_dtype, one_hot, planes, wanted
from wrongturn_agents.models.linknet import LinkNetDecoder
from wrongturn_agents.models.resnet import DEPTHS_34, WIDTHS, ResNet, updated_statistics
from wrongturn_protocol.observations import IMAGE_SHAPE
from wrongturn_protocol.segmentation import SegmentationClass

FEATURES = 512
"""Width of a picture's features."""
PROJECTIONS: Final = ("elu", "relu")
"""Ends of the layer that projects a ResNet's output: with ``elu``, a layer normalisation comes before it."""
_DEEP = WIDTHS[-1] * 2 * 6


class Encoder(nn.Module, ABC):
    """The part of an agent that sees."""

    width = FEATURES
    """Numbers that :meth:`forward` returns for a picture."""

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


class NatureCNN(nn.Module):
    """The small encoder of Mnih et al., "Human-level control through deep reinforcement learning" (2015).

    Three convolutions and a linear layer, with the sizes that Stable-Baselines3 uses.

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


class MaskedClasses(nn.Module):
    """Hides whole classes of a picture, each with a probability: their pixels become void. Sky is never hidden.

    The paper's proposal against agents that depend on a single class.
    """

    def __init__(self, probability: float) -> None:
        super().__init__()
        self.probability = probability

    def forward(self, segmentation: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Hide classes in pictures (B, 64, 192) uint8."""
        device = segmentation.device
        classes = torch.arange(CLASSES, device=device)
        hidden = torch.rand(len(segmentation), CLASSES, device=device, generator=generator) < self.probability
        hidden = hidden & (classes != int(SegmentationClass.SKY))
        table = torch.where(hidden, int(SegmentationClass.VOID), classes).to(segmentation.dtype)
        return table.gather(1, segmentation.flatten(1).long()).view_as(segmentation)


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
    """ResNet-34 on RGB, with a decoder from which it learns segmentation."""

    width = _DEEP
    frozen = False
    """Whether the ResNet and its decoder stay as they are."""

    def __init__(self, *, projection: str = "elu") -> None:
        super().__init__()
        self.augmentation = Augmentation()
        self.network = ResNet(3, DEPTHS_34)
        self.decoder = LinkNetDecoder()
        ends = (nn.LayerNorm(FEATURES), nn.ELU()) if projection == "elu" else (nn.ReLU(),)
        self.projection = nn.Sequential(nn.LayerNorm(_DEEP), nn.Linear(_DEEP, FEATURES), *ends)

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

    @torch.no_grad()
    def update_statistics(self, observation: Observation) -> None:
        """Update batch normalisation on the driving path with a batch, unless it is frozen."""
        with updated_statistics(self.network, updated=not self.frozen):
            self.network(self.planes(observation))

    def planes(self, observation: Observation) -> Tensor:
        """Return the picture as the ResNet's input, (B, 3, 64, 192)."""
        return planes(wanted(observation, "rgb"), encoding_dtype(next(self.network.parameters())))


class ImageEncoder(PictureEncoder):
    """ResNet-34 that learns segmentation first, through a decoder without links, and is then frozen."""

    def __init__(self, *, frozen: bool = True, projection: str = "elu") -> None:
        super().__init__(projection=projection)
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


class AuxiliaryEncoder(PictureEncoder):
    """ResNet-34 with its last stage twice, for driving and for segmentation, and a decoder with links."""

    def __init__(self, *, projection: str = "elu") -> None:
        super().__init__(projection=projection)
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
