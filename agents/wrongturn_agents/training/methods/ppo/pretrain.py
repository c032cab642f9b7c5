"""Teach an encoder segmentation on frames of random places, before it drives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.models.encoders import ImageEncoder
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.methods.ppo.config import ImageConfig
from wrongturn_agents.training.methods.wandering import Pool, wander, wandering_cars

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
    size = min(POOL, config.pretraining_frames)
    frames = Pool(size)
    encoder = model.encoder
    assert isinstance(encoder, ImageEncoder)
    encoder.freeze(False)
    model.train()
    total = max(1, round(config.pretraining_frames * config.pretraining_passes / config.pretraining_batch))
    optimizer = torch.optim.AdamW(
        [parameter for parameter in model.encoder.parameters() if parameter.requires_grad],
        lr=config.pretraining_rate,
        fused=device.type == "cuda",  # one kernel for all weights, because launches take most of the time
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, config.pretraining_rate, total_steps=total + 1)
    done, rendered, loss = 0, 0, torch.zeros((), device=device)
    observation = envs.reset()
    while done < total and not budget.over():
        if rendered < config.pretraining_frames:
            frames.add(observation)
            rendered += config.num_envs
            observation = envs.step(wander(random, config.num_envs))[0]
        due = total if rendered >= config.pretraining_frames else total * rendered // config.pretraining_frames
        if len(frames) < min(size, 4 * config.pretraining_batch):
            continue
        while done < due and not budget.over():
            batch = frames.draw(config.pretraining_batch)
            with torch.autocast(device.type, torch.bfloat16, enabled=config.bf16 and device.type == "cuda"):
                loss = model.segmentation_loss(batch, augment=config.augment)
            optimizer.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            optimizer.step()
            schedule.step()
            done += 1
            if done % 50 == 0:
                on_note(f"pretraining, {rendered:,} frames, loss {loss.item():.3f}")
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
    confusion = torch.zeros((_CLASSES, _CLASSES), dtype=torch.int64, device=envs.device)
    for _ in range(12):
        for _ in range(10):
            observation = envs.step(wander(random, config.num_envs))[0]
        chosen = {name: tensor[:64] for name, tensor in observation.items()}
        logits = model.segmentation_logits(chosen).float()
        truth = chosen["segmentation"].long()
        losses.append(torch.nn.functional.cross_entropy(logits, truth).item())
        pairs: Tensor = truth.flatten() * _CLASSES + logits.argmax(1).flatten()
        confusion += torch.bincount(pairs, minlength=_CLASSES**2).view(_CLASSES, _CLASSES)
        if config.num_envs * len(losses) >= 768:
            break
    hits = confusion.diagonal().double()
    union = confusion.sum(0) + confusion.sum(1) - confusion.diagonal()
    there = confusion.sum(1) > 0
    return (
        sum(losses) / len(losses),
        (hits.sum() / confusion.sum()).item(),
        (hits[there] / union[there].clamp_min(1)).mean().item(),
    )
