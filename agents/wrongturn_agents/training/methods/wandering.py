"""How an encoder learns to see before it drives: by cars that start anywhere, off the lane and askew."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.cars import cruises, training_cars
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch


def wandering_cars(config: DrivesConfig, device: torch.device, *, threads: int, **journeys: float) -> DrivingVecEnv:
    """Make such cars, which see ``rgb`` and ``segmentation``.

    If the config has traffic, all drives have the most of it: the policy cannot see what a frozen encoder never saw.

    Args:
        config: number of cars, and traffic.
        device: device of the pictures.
        threads: threads that share the simulation.
        journeys: further options of the drives, such as ``time_limit``.
    """
    options: dict[str, Any] = cruises(config)
    options["journeys"] = {"near_bends": 0.25, "near_junctions": 0.4, "lateral": 0.7, "yaw": 0.2, **journeys}
    # A stopwatch of the GPU would wait after each step, and learning could not continue meanwhile.
    watch = Stopwatch(torch.device("cpu"))
    return training_cars(
        None, device, settings=config, keys=("rgb", "segmentation"), threads=threads, stopwatch=watch,
        **{**options, "track": "segmentation"},
    )  # fmt: skip


def wander(random: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Draw actions (count, 2) with which such cars drive about: steer and accelerate."""
    return np.stack([random.normal(0.0, 0.2, count), random.uniform(-0.2, 0.8, count)], -1)


class Pool:
    """The newest rows of several tensors, on the device: a new row replaces the oldest."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._kept: dict[str, Tensor] = {}
        self.added = 0
        """Number of rows so far, with those that are gone."""

    def __len__(self) -> int:
        return min(self.added, self.size)

    def add(self, rows: dict[str, Tensor]) -> None:
        """Add rows (n, ...) of each tensor in the place of the oldest."""
        count = len(next(iter(rows.values())))
        for name, given in rows.items():
            if name not in self._kept:
                self._kept[name] = torch.empty((self.size, *given.shape[1:]), dtype=given.dtype, device=given.device)
            places = (torch.arange(count, device=given.device) + self.added) % self.size
            self._kept[name][places] = given
        self.added += count

    def draw(self, count: int) -> dict[str, Tensor]:
        """Return rows at random, from the device's torch generator."""
        device = next(iter(self._kept.values())).device
        rows = torch.randint(len(self), (count,), device=device)
        return {name: kept[rows] for name, kept in self._kept.items()}


def learn_to_see(
    config: Any,
    pool: Pool,
    optimizer: torch.optim.Optimizer,
    following: Callable[[], dict[str, Tensor]],
    loss_of: Callable[[dict[str, Tensor]], Tensor],
    *,
    least: int,
    budget: Budget,
    on_step: Callable[[float], None],
    on_note: Callable[[str], None],
    minutes: float = math.inf,
) -> tuple[int, int]:
    """Learn from rendered pictures while more are rendered, and return the numbers of pictures and of minibatches.

    Args:
        config: numbers of pictures and passes, and the minibatch's size.
        pool: keeps the newest pictures.
        optimizer: of what learns.
        following: renders the next pictures of all cars.
        loss_of: returns the loss of a minibatch.
        least: minibatches of pictures before anything is learned.
        budget: all ends when it is over.
        on_step: called with the share that is over, after each minibatch.
        on_note: told now and then how far it is.
        minutes: most minutes.
    """
    frames, batch, begin = config.pretraining_frames, config.pretraining_batch, time.monotonic()
    total = max(1, round(frames * config.pretraining_passes / batch))
    done = rendered = 0

    def over() -> float:
        return 1.0 if budget.over() else max(done / total, (time.monotonic() - begin) / (60.0 * minutes))

    while over() < 1.0:
        if rendered < frames:
            pool.add(following())
            rendered += config.num_envs
        due = total if rendered >= frames else total * rendered // frames
        if len(pool) < min(pool.size, least * batch):
            continue
        while done < due and over() < 1.0:
            drawn = pool.draw(batch)
            kind = next(iter(drawn.values())).device.type
            with torch.autocast(kind, torch.bfloat16, enabled=config.bf16 and kind == "cuda"):
                loss = loss_of(drawn)
            optimizer.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            optimizer.step()
            done += 1
            on_step(over())
            if done % 50 == 0:
                on_note(f"pretraining, {rendered:,} frames, loss {loss.item():.3f}")
    return rendered, done


class Confusion:
    """How often each class of pixels is told as each."""

    def __init__(self, classes: int, device: torch.device) -> None:
        self._counts = torch.zeros((classes, classes), dtype=torch.int64, device=device)

    def add(self, truth: Tensor, logits: Tensor) -> None:
        """Count pictures: true classes (n, 64, 192) int64 and logits (n, classes, 64, 192)."""
        classes = len(self._counts)
        pairs = truth.flatten() * classes + logits.argmax(1).flatten()
        self._counts += torch.bincount(pairs, minlength=classes**2).view(classes, classes)

    @property
    def accuracy(self) -> float:
        """Share of pixels with the right class."""
        return (self._counts.diagonal().double().sum() / self._counts.sum()).item()

    @property
    def iou(self) -> float:
        """Mean intersection over union of the classes that occur."""
        counts, hits = self._counts, self._counts.diagonal().double()
        union = counts.sum(0) + counts.sum(1) - counts.diagonal()
        there = counts.sum(1) > 0
        return (hits[there] / union[there].clamp_min(1)).mean().item()
