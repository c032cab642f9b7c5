"""An observation's arrays as a network's input, so that an exported graph holds the whole agent."""

from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

from wrongturn_protocol.observations import IMAGE_SHAPE
from wrongturn_protocol.segmentation import SegmentationClass

Observation = Mapping[str, Tensor]
"""A batch of observations: one tensor for each key of the track's space, with a batch axis in front."""

CLASSES: Final = len(SegmentationClass)
"""Number of segmentation classes."""


def wanted(observation: Observation, key: str) -> Tensor:
    """Return a batch's images: ``rgb`` (B, 64, 192, 3) or ``segmentation`` (B, 64, 192)."""
    image = observation.get(key)
    if image is None:
        raise ValueError(f"{key}: not among the observation's {', '.join(observation)}; use a track that has it")
    shape = (*IMAGE_SHAPE, 3) if key == "rgb" else IMAGE_SHAPE
    if image.shape[1:] != shape:
        raise ValueError(f"{key}: shape {tuple(image.shape)}; it must be (B, {', '.join(map(str, shape))})")
    return image


def encoding_dtype(like: Tensor) -> torch.dtype:
    """Return the dtype in which a convolution computes here: autocast's, or its weights'."""
    device = like.device.type
    return torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else like.dtype


def planes(rgb: Tensor, dtype: torch.dtype) -> Tensor:
    """Return pictures (B, 64, 192, 3) uint8 as (B, 3, 64, 192) in [-1, 1], with the channels last in memory."""
    return rgb.permute(0, 3, 1, 2).to(dtype) * (2.0 / 255.0) - 1.0


def one_hot(segmentation: Tensor, dtype: torch.dtype) -> Tensor:
    """Return class numbers (B, 64, 192) uint8 as (B, 11, 64, 192) of 0 and 1, with the channels last in memory."""
    # torch's own one_hot uses int64: eight times the memory of the network's widest tensor.
    classes = torch.arange(CLASSES, dtype=segmentation.dtype, device=segmentation.device)
    return (segmentation.unsqueeze(-1) == classes).to(dtype).permute(0, 3, 1, 2)
