"""Settings of the training of ``doubting``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DoubtingConfig:
    """Settings of a training; the defaults are those of the shipped agents."""

    key: str = "rgb"
    """Picture that the network sees: ``rgb`` or ``segmentation``."""
    pictures: int = 2_000_000
    """Pictures to learn from. The learning rate falls over them."""
    batch_size: int = 256
    """Pictures in a minibatch, a multiple of 64."""
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
    """*Ablation.* Number of generated towns beside Town01."""
    first_share: float = 0.3
    """Share of the pictures that show Town01."""
    show_every: float = 15.0
    """Seconds between two reports of progress."""
