"""ResNet-34 and ResNet-18, built from a configuration, never downloaded.

He et al., "Deep residual learning for image recognition" (2016).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from torch import Tensor, nn

from wrongturn_protocol.installing import install

WIDTHS: Final = (64, 128, 256, 512)
"""Channels after each of the four stages. For a picture of 64 x 192 their sizes are 16 x 48, 8 x 24, 4 x 12 and 2 x
6.
"""
DEPTHS_18: Final = (2, 2, 2, 2)
"""Blocks in each stage of ResNet-18."""
DEPTHS_34: Final = (3, 4, 6, 3)
"""Blocks in each stage of ResNet-34."""


def new_resnet(channels: int, depths: Sequence[int], widths: Sequence[int] = WIDTHS) -> Any:
    """Return a ResNet of basic blocks as transformers makes it, with weights drawn at random."""
    try:
        # Imported here, because it takes seconds and not every agent needs it.
        from transformers import ResNetConfig, ResNetModel  # noqa: PLC0415
    except ModuleNotFoundError as error:
        if error.name != "transformers":  # it is there, and lacks something itself
            raise
        remedy = install("wrongturn-agents[training]")
        raise ModuleNotFoundError(f"ResNets are made by transformers; install it with: {remedy}") from error
    sizes = {"embedding_size": widths[0], "hidden_sizes": list(widths), "depths": list(depths)}
    return ResNetModel(ResNetConfig(num_channels=channels, layer_type="basic", **sizes))


class ResNet(nn.Module):
    """The stem and the four stages, kept apart so that a stage can be doubled.

    Batch normalisation uses its running statistics even in training, so that PPO improves exactly the policy that
    drove. Only within :func:`updated_statistics` does it use a batch's statistics and learn from them. Of several
    pictures one behind the other, each has 3 of the channels.

    Attributes:
        stem: (B, ``channels``, 64, 192) to (B, 64, 16, 48).
        stages: four; see :data:`WIDTHS`.
    """

    def __init__(self, channels: int, depths: Sequence[int], widths: Sequence[int] = WIDTHS) -> None:
        super().__init__()
        whole = new_resnet(channels, depths, widths)
        self.stem: nn.Module = whole.embedder
        self.stages = nn.ModuleList(whole.encoder.stages)
        self.eval()

    def train(self, mode: bool = True) -> "ResNet":  # noqa: ARG002 - torch's signature
        """Stay in evaluation mode. Only batch normalisation would behave differently."""
        super().train(False)
        return self

    def shared(self, picture: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the outputs of the stem and of the first three stages."""
        stem = self.stem(picture)
        first = self.stages[0](stem)
        second = self.stages[1](first)
        return stem, first, second, self.stages[2](second)

    def forward(self, picture: Tensor) -> Tensor:
        """Encode pictures (B, ``channels``, 64, 192) as (B, 512, 2, 6)."""
        encoded: Tensor = self.stages[3](self.shared(picture)[3])
        return encoded


@contextmanager
def updated_statistics(part: nn.Module, *, updated: bool = True) -> Iterator[None]:
    """Let the batch normalisation of a part use and learn the statistics of the batches in this block."""
    norms = [norm for norm in part.modules() if isinstance(norm, nn.BatchNorm2d)] if updated else []
    for norm in norms:
        norm.training = True
    try:
        yield
    finally:
        for norm in norms:
            norm.training = False
