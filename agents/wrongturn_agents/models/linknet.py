"""The decoder of LinkNet, a network for segmentation made of ResNets.

Chaurasia and Culurciello, "LinkNet: exploiting encoder representations for efficient semantic segmentation" (2017).
"""

from collections.abc import Sequence

from torch import Tensor, nn

from wrongturn_agents.models.inputs import CLASSES
from wrongturn_agents.models.resnet import WIDTHS


class LinkNetDecoder(nn.Module):
    """Decoder from the last stage's features to a class for each pixel.

    Each block doubles the picture's size and adds the encoder's output of that size, if it is given. Without these
    links, all that the decoder knows has come through the last stage, which learns to hold it.
    """

    def __init__(self, widths: Sequence[int] = WIDTHS, classes: int = CLASSES) -> None:
        super().__init__()
        first, second, third, fourth = widths
        self.blocks = nn.ModuleList(
            [_block(fourth, third, 2), _block(third, second, 2), _block(second, first, 2), _block(first, first, 1)]
        )
        self.full = nn.Sequential(
            *_normalised(nn.ConvTranspose2d(first, 32, 3, stride=2, padding=1, output_padding=1, bias=False), 32),
            *_normalised(nn.Conv2d(32, 32, 3, padding=1, bias=False), 32),
            nn.ConvTranspose2d(32, classes, 2, stride=2),
        )

    def forward(self, deep: Tensor, links: Sequence[Tensor] = ()) -> Tensor:
        """Decode the last stage's (B, 512, 2, 6) to logits (B, ``classes``, 64, 192).

        Links are the outputs of the third, second and first stage and of the stem, in this order; or nothing.
        """
        for number, block in enumerate(self.blocks):
            deep = block(deep)
            if links:
                deep = deep + links[number]
        logits: Tensor = self.full(deep)
        return logits


def _block(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    narrow = inputs // 4
    upward = nn.ConvTranspose2d(narrow, narrow, 3, stride, padding=1, output_padding=stride - 1, bias=False)
    return nn.Sequential(
        *_normalised(nn.Conv2d(inputs, narrow, 1, bias=False), narrow),
        *_normalised(upward, narrow),
        *_normalised(nn.Conv2d(narrow, outputs, 1, bias=False), outputs),
    )


def _normalised(convolution: nn.Module, channels: int) -> tuple[nn.Module, ...]:
    return convolution, nn.BatchNorm2d(channels), nn.ReLU()
