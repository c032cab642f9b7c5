"""Build an agent's networks by the algorithm's name."""

from typing import Final

import torch

from wrongturn_agents.models.actor_critic import ActorCritic
from wrongturn_agents.models.augmentation import AugmentationConfig
from wrongturn_agents.models.encoders import AuxiliaryEncoder, Encoder, ImageEncoder, SegmentationEncoder

ALGORITHMS: Final = ("ppo-segmentation", "ppo-image", "ppo-auxiliary")
"""The paper's three agents."""


def build(
    algorithm: str,
    *,
    seed: int | None = None,
    masked_classes: float = 0.0,
    frozen: bool | None = None,
    augmentation: AugmentationConfig | None = None,
    activation: str = "tanh",
) -> ActorCritic:
    """Build an agent's networks, untrained, on the CPU, with their convolutions' channels last in memory.

    Args:
        algorithm: one of :data:`ALGORITHMS`.
        seed: seed of the first weights. Without one, torch's own random state is used. With one, that state stays as it
            is.
        masked_classes: for ``ppo-segmentation``: probability that a class is hidden when observations are disturbed.
        frozen: for ``ppo-image``: whether its ResNet stays as it is; True by default. It learns segmentation unfrozen
            and drives frozen: ``encoder.freeze(...)``.
        augmentation: for the two agents that see RGB: how much pictures are changed.
        activation: activation of the heads: ``tanh``, ``elu`` or ``relu``.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm: {algorithm!r} is none of {', '.join(ALGORITHMS)}")
    if masked_classes and algorithm != "ppo-segmentation":
        raise ValueError(f"masked_classes: {algorithm} is given no segmentation; leave it out")
    if frozen is not None and algorithm != "ppo-image":
        raise ValueError(f"frozen: {algorithm} has no pretrained encoder; leave it out")
    if augmentation is not None and algorithm == "ppo-segmentation":
        raise ValueError(f"augmentation: {algorithm} is given no picture; leave it out")

    def encoder() -> Encoder:
        if algorithm == "ppo-segmentation":
            return SegmentationEncoder(masked_classes)
        if algorithm == "ppo-image":
            return ImageEncoder(frozen=frozen is not False, augmentation=augmentation)
        return AuxiliaryEncoder(augmentation=augmentation)

    with torch.random.fork_rng(devices=[], enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(seed)
        model = ActorCritic(algorithm, encoder(), activation=activation)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return model
