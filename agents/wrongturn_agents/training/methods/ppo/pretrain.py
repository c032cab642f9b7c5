"""Teach an encoder segmentation on frames of random places, before it drives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.models.encoders import ImageEncoder
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.driving_env import DrivingVecEnv, Observations
from wrongturn_agents.training.methods.ppo.config import ImageConfig
from wrongturn_agents.training.methods.wandering import Confusion, Pool, learn_to_see, wander, wandering_cars

POOL = 16_384
"""Number of frames kept at a time. A new frame replaces the oldest one."""
_CLASSES = 11


@dataclass(frozen=True)
class Pretraining:
    """Result of a pretraining, on frames that were not learned from."""

    frames: int
    """Rendered frames."""
    minibatches: int
    loss: float
    """Mean cross-entropy of a pixel."""
    accuracy: float
    """Share of pixels with the right class."""
    iou: float
    """Mean intersection over union of the classes that occur."""


def pretrain(
    model: ActorCritic,
    config: ImageConfig,
    *,
    device: torch.device,
    seed: int,
    budget: Budget,
    threads: int,
    on_note: Callable[[str], None] = lambda _: None,
) -> Pretraining:
    """Train an agent's encoder with cross-entropy, together with a decoder that is not used afterwards.

    Cars start anywhere, off the lane's centre and askew, drive with random actions for a second, and start elsewhere.

    Args:
        model: an image agent on the device. Its encoder is frozen afterwards.
        config: number of frames, passes and learning rate, cars and traffic.
        device: device of the model.
        seed: seed of the frames.
        budget: pretraining stops when it is over.
        threads: threads that share the simulation.
        on_note: told now and then how far it is.
    """
    envs = wandering_cars(config, device, threads=threads, time_limit=1.0)
    envs.seed(seed)
    random = np.random.default_rng(seed)
    encoder = model.encoder
    assert isinstance(encoder, ImageEncoder)
    encoder.freeze(False)
    model.train()
    optimizer = torch.optim.AdamW(
        [parameter for parameter in encoder.parameters() if parameter.requires_grad],
        lr=config.pretraining_rate,
        fused=device.type == "cuda",  # one kernel for all weights, because launches take most of the time
    )
    total = max(1, round(config.pretraining_frames * config.pretraining_passes / config.pretraining_batch))
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, config.pretraining_rate, total_steps=total + 1)
    observation = envs.reset()

    def following() -> Observations:
        nonlocal observation
        shown = observation
        observation = envs.step(wander(random, config.num_envs))[0]
        return shown

    rendered, done = learn_to_see(
        config,
        Pool(min(POOL, config.pretraining_frames)),
        optimizer,
        following,
        lambda batch: model.segmentation_loss(batch, augment=config.augment),
        least=4,
        budget=budget,
        on_step=lambda _: schedule.step(),
        on_note=on_note,
    )
    model.eval()
    found = _examined(model, envs, random, config)
    envs.close()
    encoder.freeze()
    return Pretraining(rendered, done, *found)


@torch.inference_mode()
def _examined(
    model: ActorCritic, envs: DrivingVecEnv, random: np.random.Generator, config: ImageConfig
) -> tuple[float, float, float]:
    """Return loss, accuracy and mean IoU on frames that come after those learned from."""
    losses: list[float] = []
    confusion = Confusion(_CLASSES, envs.device)
    for _ in range(12):
        for _ in range(10):
            observation = envs.step(wander(random, config.num_envs))[0]
        chosen = {name: tensor[:64] for name, tensor in observation.items()}
        logits = model.segmentation_logits(chosen).float()
        truth = chosen["segmentation"].long()
        losses.append(torch.nn.functional.cross_entropy(logits, truth).item())
        confusion.add(truth, logits)
        if config.num_envs * len(losses) >= 768:
            break
    return sum(losses) / len(losses), confusion.accuracy, confusion.iou
