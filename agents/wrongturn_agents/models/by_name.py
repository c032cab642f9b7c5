"""Build an agent's networks by the algorithm's name."""

from collections.abc import Callable
from typing import Final

import torch

from wrongturn_agents.models.actor_critic import ActorCritic
from wrongturn_agents.models.encoders import AuxiliaryEncoder, Encoder, ImageEncoder, SegmentationEncoder

ALGORITHMS: Final = ("ppo-segmentation", "ppo-image", "ppo-auxiliary")
"""The paper's three agents."""


def build(
    algorithm: str,
    *,
    seed: int | None = None,
    masked_classes: float = 0.0,
    frozen: bool = True,
    activation: str = "tanh",
) -> ActorCritic:
    """Build an agent's networks, untrained, on the CPU, with their convolutions' channels last in memory.

    Args:
        algorithm: one of :data:`ALGORITHMS`.
        seed: seed of the first weights. Without one, torch's own random state is used. With one, that state stays as it
            is.
        masked_classes: for ``ppo-segmentation``: probability that a class is hidden when observations are disturbed.
        frozen: for ``ppo-image``: whether its ResNet stays as it is. It learns segmentation unfrozen and drives frozen:
            ``encoder.freeze(...)``.
        activation: activation of the heads: ``tanh``, ``elu`` or ``relu``.
    """
    encoders: dict[str, Callable[[], Encoder]] = {
        "ppo-segmentation": lambda: SegmentationEncoder(masked_classes),
        "ppo-image": lambda: ImageEncoder(frozen=frozen),
        "ppo-auxiliary": AuxiliaryEncoder,
    }
    if algorithm not in encoders:
        raise ValueError(f"algorithm: {algorithm!r} is none of {', '.join(ALGORITHMS)}")
    with torch.random.fork_rng(devices=[], enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(seed)
        model = ActorCritic(algorithm, encoders[algorithm](), activation=activation)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return model
