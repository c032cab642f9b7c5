"""Random changes of pictures, so that an agent learns what does not depend on them."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

_DRAWS = 13
_REACH = 3  # pixels to either side that a blur takes in: twice its largest standard deviation


@dataclass(frozen=True)
class AugmentationConfig:
    """Strength of each change in the paper's list: partial erasing, Gaussian blur, hue, saturation, brightness."""

    erasing: float = 0.5
    """Share of pictures in which a rectangle is hidden."""
    erased: tuple[float, float] = (0.02, 0.25)
    """Smallest and largest share of the picture that the rectangle hides."""
    blurring: float = 0.3
    """Share of pictures that are blurred."""
    blur: tuple[float, float] = (0.3, 1.5)
    """Smallest and largest standard deviation of the blur, pixels."""
    hue: float = 18.0
    """Largest turn of the hue to either side, degrees."""
    saturation: tuple[float, float] = (0.5, 1.5)
    """Smallest and largest factor of the colours' distance from grey."""
    brightness: tuple[float, float] = (0.6, 1.4)
    """Smallest and largest factor of the light."""


class Augmentation(nn.Module):
    """Changes each picture of a batch by its own erasing, blur, hue, saturation and brightness."""

    colours: Tensor

    def __init__(self, config: AugmentationConfig | None = None) -> None:
        super().__init__()
        self.config = config or AugmentationConfig()
        self.register_buffer("colours", _colour_bases(), persistent=False)

    def forward(self, rgb: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Return changed pictures (B, 64, 192, 3) uint8. The generator is on their device; None for torch's own."""
        return self.changed(rgb, self.draw(len(rgb), rgb.device, generator))

    def draw(self, count: int, device: torch.device, generator: torch.Generator | None = None) -> Tensor:
        """Return the random numbers that change pictures, (count, 13) in [0, 1)."""
        return torch.rand(count, _DRAWS, device=device, generator=generator)

    def changed(self, rgb: Tensor, draws: Tensor) -> Tensor:
        """Return pictures changed by given random numbers (B, 13) in [0, 1)."""
        batch, height, width, _ = rgb.shape
        dtype = torch.float16 if rgb.is_cuda else torch.float32  # half of the traffic, and finer than uint8
        with torch.autocast(rgb.device.type, enabled=False):
            pictures = rgb.permute(0, 3, 1, 2).to(dtype)
            matrix = self._colour(draws[:, :3]).to(dtype).view(batch, 3, 3, 1, 1)
            red, green, blue = (pictures[:, i : i + 1] * matrix[:, :, i] for i in range(3))
            pictures = self._blurred((red + green + blue).clamp(0, 255), draws[:, 3:5])
            fill = (draws[:, 5:8] * 255).to(dtype).view(batch, 3, 1, 1)
            pictures = torch.where(self._erased(draws[:, 8:13], height, width), fill, pictures)
        return pictures.round().to(torch.uint8).permute(0, 2, 3, 1).contiguous()

    def _colour(self, draws: Tensor) -> Tensor:
        """Return matrices (B, 3, 3) that turn hues, stretch colours and scale light."""
        angle = (2 * draws[:, 0] - 1) * math.radians(self.config.hue)
        light = _between(draws[:, 2], self.config.brightness)
        stretch = light * _between(draws[:, 1], self.config.saturation)
        shares = torch.stack([light, stretch * angle.cos(), stretch * angle.sin()], 1)
        return (shares @ self.colours).view(-1, 3, 3)

    def _blurred(self, pictures: Tensor, draws: Tensor) -> Tensor:
        batch, planes, height, width = pictures.shape
        sigma = _between(draws[:, 1:2], self.config.blur)
        offsets = torch.arange(-_REACH, _REACH + 1, device=draws.device)
        weights = torch.exp(-((offsets / sigma) ** 2) / 2)
        weights = torch.where(draws[:, :1] < self.config.blurring, weights, (offsets == 0).to(weights.dtype))
        weights = (weights / weights.sum(1, keepdim=True)).to(pictures.dtype)
        weights = weights.repeat_interleave(planes, 0).view(batch * planes, 1, -1, 1)
        # Each plane has its own kernel, so the convolution has one group for each plane.
        row = pictures.reshape(1, batch * planes, height, width)
        row = functional.conv2d(
            functional.pad(row, (0, 0, _REACH, _REACH), "replicate"), weights, groups=batch * planes
        )
        row = functional.pad(row, (_REACH, _REACH, 0, 0), "replicate")
        row = functional.conv2d(row, weights.transpose(2, 3), groups=batch * planes)
        return row.view(batch, planes, height, width)

    def _erased(self, draws: Tensor, height: int, width: int) -> Tensor:
        """Return which pixels are hidden, (B, 1, H, W)."""
        area = _between(draws[:, 1], self.config.erased) * height * width
        ratio = torch.exp(_between(draws[:, 2], (-math.log(3), math.log(3))))
        size = [(area * ratio).sqrt().clamp(max=height), (area / ratio).sqrt().clamp(max=width)]
        inside = (draws[:, 0] < self.config.erasing).view(-1, 1, 1, 1)
        for axis, (length, whole) in enumerate(zip(size, (height, width), strict=True)):
            begin = (draws[:, 3 + axis] * (whole - length)).view(-1, 1)
            pixels = torch.arange(whole, device=draws.device)
            within = (pixels >= begin) & (pixels < begin + length.view(-1, 1))
            inside = inside & (within.view(-1, 1, whole, 1) if axis == 0 else within.view(-1, 1, 1, whole))
        return inside


def _between(draw: Tensor, limits: tuple[float, float]) -> Tensor:
    return limits[0] + draw * (limits[1] - limits[0])


def _colour_bases() -> Tensor:
    """Return three matrices (3, 9). A weighted sum of them changes light, saturation and hue.

    In YIQ, hue is an angle about the axis of greys, and saturation is the distance from it. The first matrix gives the
    luma, which a change of colour keeps. The second gives the rest, and the third gives the rest turned by 90 degrees.
    """
    luma = torch.tensor([0.299, 0.587, 0.114], dtype=torch.float64)
    yiq = torch.stack(
        [luma, torch.tensor([0.596, -0.274, -0.322]).double(), torch.tensor([0.211, -0.523, 0.312]).double()]
    )
    quarter = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float64)
    grey = luma.expand(3, 3)
    turned = torch.linalg.inv(yiq) @ quarter @ yiq
    return torch.stack([grey, torch.eye(3, dtype=torch.float64) - grey, turned]).view(3, 9).float()
