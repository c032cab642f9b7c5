"""Teach MaRLn's encoder affordances on stacks of pictures, before it drives."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from wrongturn_agents.models.affordances import GROUPS, Affordances
from wrongturn_agents.models.marln import Marln, disturb
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.methods.marln.config import MarlnConfig
from wrongturn_agents.training.methods.marln.frames import FrameStack
from wrongturn_agents.training.methods.marln.truth import RoadTruth
from wrongturn_agents.training.methods.wandering import Confusion, Pool, learn_to_see, wander, wandering_cars
from wrongturn_networks import load_town

_POOL: Final = 16_384
"""Number of stacks kept at a time. A new one replaces the oldest."""
_WARM_UP: Final = 0.1
"""Share of pretraining over which the learning rate rises."""
_EXAMINED: Final = 2_048
"""Most stacks on which a pretraining is examined."""


@dataclass(frozen=True)
class Pretraining:
    """Result of a pretraining, on stacks that were not learned from."""

    frames: int
    """Stacks that were rendered."""
    minibatches: int
    accuracy: float
    """Share of pixels with the right class."""
    iou: float
    """Mean intersection over union of the classes that occur."""
    inside: float
    """Share of right answers to whether the car is inside a junction."""
    distance: float
    """Mean error of the distance to the junction, metres."""
    lateral: float
    """Mean error of the distance to the lane's centre, outside junctions, metres."""
    angle: float
    """Mean error of the angle to the lane, outside junctions, degrees."""


class Source:
    """Cars that wander about, what they see, and the truth about it.

    They start anywhere, off the lane's centre and askew, drive with random actions for a second and a half, and start
    elsewhere.

    Args:
        threads: threads that share the simulation.
    """

    def __init__(self, config: MarlnConfig, seed: int, device: torch.device, threads: int) -> None:
        self._envs = wandering_cars(config, device, threads=threads, inside_junctions=0.1, time_limit=1.5)
        self._envs.seed(seed)
        self._random = np.random.default_rng(seed)
        self._truth = RoadTruth(load_town("Town01"))
        self._stack = FrameStack()
        self._device = device
        self._observation = self._envs.reset()
        self._begun = torch.ones(config.num_envs, dtype=torch.bool, device=device)

    def next(self) -> tuple[Tensor, Tensor, Affordances]:
        """Return stacks (n, 4, 64, 192, 3), segmentations (n, 64, 192) and affordances, and drive on."""
        frames = self._stack.push(self._observation["rgb"], self._begun)
        seen = frames, self._observation["segmentation"], self._truth.of(self._envs.poses, self._device)
        count = self._envs.num_envs
        self._observation, _, ended, _ = self._envs.step(wander(self._random, count))
        self._begun = torch.as_tensor(ended, device=self._device)
        return seen

    def close(self) -> None:
        """Stop the threads."""
        self._envs.close()


def pretrain(
    model: Marln,
    config: MarlnConfig,
    *,
    device: torch.device,
    seed: int,
    budget: Budget,
    threads: int,
    on_note: Callable[[str], None] = lambda _: None,
) -> Pretraining:
    """Train the encoder on affordances, with heads that are not used afterwards.

    Args:
        model: the agent on the device.
        config: number of stacks, passes, minutes and learning rate.
        device: device of the model.
        seed: seed of the drives.
        budget: pretraining stops when it is over.
        threads: threads that share the simulation.
        on_note: told now and then how far it is.
    """
    source = Source(config, seed, device, threads)
    model.affordances.train()
    weights = [weight for part in (model.network, model.affordances) for weight in part.parameters()]
    optimizer = torch.optim.AdamW(weights, lr=config.pretraining_rate, fused=device.type == "cuda")

    def following() -> dict[str, Tensor]:
        frames, segmentation, truth = source.next()
        return {"frames": frames, "segmentation": segmentation, **truth._asdict()}

    def loss_of(drawn: dict[str, Tensor]) -> Tensor:
        frames = disturb(model.augmentation, drawn["frames"]) if config.augment else drawn["frames"]
        truth = Affordances(*(drawn[name] for name in Affordances._fields))
        return model.affordances.loss(model.learn_to_see(frames), drawn["segmentation"], truth)

    def on_step(over: float) -> None:
        for group in optimizer.param_groups:
            group["lr"] = config.pretraining_rate * _risen(over)

    on_step(0.0)
    rendered, done = learn_to_see(
        config, Pool(min(_POOL, config.pretraining_frames)), optimizer, following, loss_of,
        least=2, budget=budget, on_step=on_step, on_note=on_note, minutes=config.pretraining_minutes,
    )  # fmt: skip
    model.affordances.eval()
    found = _examined(model, source, min(_EXAMINED, config.pretraining_frames))
    source.close()
    return Pretraining(rendered, done, **found)


def _risen(over: float) -> float:
    """Return the share of the greatest learning rate: it rises, then falls by a half cosine."""
    if over < _WARM_UP:
        return max(over / _WARM_UP, 0.01)
    return max(0.5 * (1.0 + math.cos(math.pi * (over - _WARM_UP) / (1.0 - _WARM_UP))), 0.01)


@torch.inference_mode()
def _examined(model: Marln, source: Source, count: int) -> dict[str, Any]:
    """Return the figures of :class:`Pretraining` on stacks that come after those learned from."""
    device = model.table.device
    confusion = Confusion(len(GROUPS), device)
    sums, outside, seen = torch.zeros(4, device=device), 0.0, 0
    while seen < count:
        for _ in range(8):
            frames, segmentation, truth = source.next()
        frames, segmentation, truth = frames[:256], segmentation[:256], Affordances(*(one[:256] for one in truth))
        deep = model.see(frames)
        confusion.add(model.affordances.groups[segmentation.long()], model.affordances.decoder(deep))
        told, on_lane = model.affordances.tell(deep), 1.0 - truth.inside
        sums += torch.stack(
            [
                ((told.inside > 0.0).float() == truth.inside).float().sum(),
                (told.distance - truth.distance).abs().sum(),
                ((told.lateral - truth.lateral).abs() * on_lane).sum(),
                ((told.angle - truth.angle).abs() * on_lane).sum(),
            ]
        )
        outside += on_lane.sum().item()
        seen += len(frames)
    inside, distance, lateral, angle = sums.tolist()
    return {
        "accuracy": confusion.accuracy,
        "iou": confusion.iou,
        "inside": inside / seen,
        "distance": distance / seen,
        "lateral": lateral / max(outside, 1.0),
        "angle": math.degrees(angle / max(outside, 1.0)),
    }
