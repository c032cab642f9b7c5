"""Teach an encoder segmentation on frames of random places, before it drives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.models.encoders import ImageEncoder
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.config import ImageConfig
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.environments import wander, wandering_envs
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.rollout import Observations

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
    on_progress: Callable[[int, float], None] = lambda *_: None,
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
        on_progress: called with the number of frames and the loss now and then.
    """
    envs = wandering_envs(config, device, threads=threads, time_limit=1.0)
    envs.seed(seed)
    random = np.random.default_rng(seed)
    frames = _Frames(min(POOL, config.pretraining_frames), device)
    encoder = model.encoder
    if not isinstance(encoder, ImageEncoder):
        raise TrainingError(f"pretraining: {model.algorithm} is trained from scratch; choose ppo-image")
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
        if frames.count < min(len(frames.rgb), 4 * config.pretraining_batch):
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
                on_progress(rendered, loss.item())
    model.eval()
    found = _examined(model, envs, random, config)
    envs.close()
    encoder.freeze()
    return Pretraining(rendered, done, *found)


class _Frames:
    """The newest frames, on the device."""

    def __init__(self, size: int, device: torch.device) -> None:
        self.rgb = torch.empty((size, 64, 192, 3), dtype=torch.uint8, device=device)
        self.segmentation = torch.empty((size, 64, 192), dtype=torch.uint8, device=device)
        self.count = 0
        self._next = 0

    def add(self, observation: Observations) -> None:
        size, number = len(self.rgb), len(observation["rgb"])
        rows = (torch.arange(number, device=self.rgb.device) + self._next) % size
        self.rgb[rows] = observation["rgb"]
        self.segmentation[rows] = observation["segmentation"]
        self._next = (self._next + number) % size
        self.count = min(size, self.count + number)

    def draw(self, number: int) -> Observations:
        rows = torch.randint(self.count, (number,), device=self.rgb.device)
        return {"rgb": self.rgb[rows], "segmentation": self.segmentation[rows]}


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
