"""An agent's networks by the algorithm's name."""

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
    """Make an agent's networks, untrained, on the CPU, their convolutions with the channels last.

    Args:
        algorithm: one of :data:`ALGORITHMS`.
        seed: of the first weights; torch's own random state where none is given, which stays as it is otherwise.
        masked_classes: ``ppo-segmentation``: probability that a class is hidden from it where it is augmented.
        frozen: ``ppo-image``: whether its ResNet stays as it is (it does, unless told otherwise). It learns
            segmentation unfrozen, drives frozen: ``encoder.freeze(...)``.
        augmentation: of the two that look at RGB: how much pictures are changed.
        activation: of the heads, ``tanh``, ``elu`` or ``relu``.

    Raises:
        ValueError: there is no such algorithm, or an argument is none of its.
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
