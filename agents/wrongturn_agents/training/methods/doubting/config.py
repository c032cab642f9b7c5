"""Settings of the training of ``doubting`` and ``doubting-segmentation``."""

from dataclasses import dataclass
from typing import ClassVar

from wrongturn_agents.training.settings import SHARE, Settings


@dataclass(frozen=True, kw_only=True)
class DoubtingConfig(Settings):
    """Settings of a training; the defaults are those of the shipped agents."""

    algorithm: ClassVar[str] = "doubting"
    RANGES: ClassVar = {
        **dict.fromkeys(("average", "first_share", "masked_classes"), SHARE),
        "generated": (0, 1e12),
        "noise": (0, 100),
    }
    BEFORE: ClassVar = {"cameras": False, "noise": 0.0, "masked_classes": 0.0}
    POSITIVE: ClassVar[tuple[str, ...]] = ("learning_rate", "marks_weight")

    pictures: int = 2_000_000
    """Pictures to learn from. The learning rate falls over them."""
    batch_size: int = 256
    """Pictures in a minibatch, in chunks of 64 of one town."""
    learning_rate: float = 1e-3
    """AdamW's greatest learning rate."""
    warm_up: int = 100
    """Updates over which the learning rate rises."""
    weight_decay: float = 0.01
    """AdamW's weight decay."""
    average: float = 0.998
    """Weight of the past in the average of the weights, which is what is kept."""
    marks_weight: float = 3.0
    """Weight of the loss about the distance."""
    augment: bool = True
    """Change RGB pictures at random."""
    bf16: bool = True
    """Compute in bfloat16 on CUDA."""
    generated: int = 40
    """*Ablation.* Number of drawn towns beside Town01."""
    first_share: float = 0.3
    """Share of the pictures that show Town01."""
    cameras: bool = True
    """Mount the cameras otherwise, as for the PPO agents: the pictures of a chunk have 64 different ones."""
    noise: float = 20.0
    """Greatest standard deviation of the noise of each pixel's red, green and blue, of 255."""
    masked_classes: float = 0.1
    """Probability with which each class of a segmentation is hidden."""
    save_every: float = 10.0
    """Minutes between two saves of ``state.pt``."""

    @property
    def length(self) -> int:
        """Pictures to learn from."""
        return self.pictures

    @property
    def variant(self) -> str | None:
        """Name of the ablation; None for the standard training."""
        return "without-generated-towns" if self.generated == 0 else None


@dataclass(frozen=True, kw_only=True)
class DoubtingSegmentationConfig(DoubtingConfig):
    """Settings of the agent that sees segmentation."""

    algorithm: ClassVar[str] = "doubting-segmentation"
