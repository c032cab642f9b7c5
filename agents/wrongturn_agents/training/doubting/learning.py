"""Learning of what a picture tells about the junction ahead."""

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import torch

from wrongturn_agents.models.doubt import Doubt
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.doubting.config import DoubtingConfig
from wrongturn_agents.training.doubting.frames import FrameSource
from wrongturn_networks import Town

_HELD_OUT_SEED: Final = 9_001
_NEAR: Final = (5.0, 16.0)
_SHOW_EVERY: Final = 15.0
"""Seconds between two reports of progress."""


@dataclass(frozen=True)
class Told:
    """How right a network is about pictures that it did not learn from."""

    exits: float
    """Share of right exits from 5 to 16 m before stop lines."""
    approaches: float
    """Share of pictures there with all three exits right."""
    distance: float
    """Mean error of the distance there, metres."""
    inside: float
    """Share of pictures that are rightly told to be nearer or farther than 2 m from the stop line."""


def learn(
    towns: Sequence[Town],
    config: DoubtingConfig,
    *,
    key: str,
    seed: int,
    budget: Budget,
    device: torch.device,
    threads: int = 1,
    on_progress: Callable[[int, float, float], None] = lambda *_: None,
) -> tuple[Doubt, int]:
    """Learn from fresh pictures until the budget is over.

    Args:
        towns: towns of the pictures; see :class:`FrameSource`.
        config: settings.
        key: picture that the network sees: ``rgb`` or ``segmentation``.
        seed: seed of weights and pictures.
        budget: pictures (its steps) and minutes.
        device: device of the network.
        threads: threads that render on the CPU.
        on_progress: called now and then with the number of pictures and both losses.

    Returns:
        The network, ready to tell, and the number of pictures that it learned from.
    """
    torch.manual_seed(seed)
    model = Doubt(key).to(device, memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    source = FrameSource(towns, seed, first_share=config.first_share, device=device, threads=threads)
    source.draw(1)  # compiles what renders, before the clock of the learning begins
    budget.begun = budget.used
    optimizer = torch.optim.AdamW(model.parameters(), config.learning_rate, weight_decay=config.weight_decay)
    average = copy.deepcopy(model)
    seen, updates = 0, 0
    shown = time.monotonic()
    while not budget.over(seen):
        share = budget.fraction(seen)
        rate = config.learning_rate * min(1.0, (updates + 1) / config.warm_up) * max(1.0 - share, 0.01)
        for group in optimizer.param_groups:
            group["lr"] = rate
        frames = source.draw(config.batch_size)
        observation = frames.observation
        if key == "rgb" and config.augment:
            observation = {**observation, "rgb": model.augmentation(observation["rgb"])}
        with torch.autocast(device.type, torch.bfloat16, enabled=config.bf16 and device.type == "cuda"):
            exits, marks = model.loss(observation, frames.distance, frames.exits, frames.shown)
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(exits + config.marks_weight * marks)
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        _move(average, model, min(config.average, updates / (updates + 10)))
        seen += len(frames.distance)
        updates += 1
        if time.monotonic() - shown > _SHOW_EVERY:
            shown = time.monotonic()
            on_progress(seen, exits.item(), marks.item())
    return average.eval(), seen


@torch.no_grad()
def _move(average: Doubt, model: Doubt, past: float) -> None:
    """Move an average of weights and statistics towards a network."""
    for kept, live in zip(average.state_dict().values(), model.state_dict().values(), strict=True):
        if kept.is_floating_point():
            kept.lerp_(live, 1.0 - past)
        else:
            kept.copy_(live)


@torch.inference_mode()
def examine(model: Doubt, towns: Sequence[Town], *, pictures: int = 4096, threads: int = 1) -> Told:
    """Return how right a network is about pictures of some towns, drawn equally often."""
    device = next(model.parameters()).device
    share = 1.0 / len(towns)
    source = FrameSource(towns, _HELD_OUT_SEED, first_share=share, device=device, threads=threads)
    right, whole, error, near, sided, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    while total < pictures:
        frames = source.draw(512)
        exits, distance = (part.float() for part in model.tell(frames.observation))
        at = (frames.distance > _NEAR[0]) & (frames.distance <= _NEAR[1])
        same = ((exits > 0) == (frames.exits > 0.5))[at]
        right += same.float().mean(1).sum().item()
        whole += same.all(1).float().sum().item()
        error += (distance[:, 0] - frames.distance).abs()[at].sum().item()
        near += at.float().sum().item()
        sided += ((distance[:, 0] > 2.0) == (frames.distance > 2.0)).float().sum().item()
        total += len(frames.distance)
    return Told(right / near, whole / near, error / near, sided / total)
