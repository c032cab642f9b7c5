"""Supervised learning from the newest samples, whose result is an average of the weights."""

import copy
from typing import Any

import torch
from torch import Tensor, nn

from wrongturn_agents.training.run import Run


class AveragedLearner:
    """An agent that learns by AdamW, and the average of its weights, which is what is kept.

    The learning rate rises over the settings' ``warm_up`` updates, and falls linearly to a hundredth. Their ``average``
    is the weight of the past.
    """

    def __init__(self, agent: nn.Module, settings: Any) -> None:
        self.live = agent.train()
        self.average = copy.deepcopy(agent).eval().requires_grad_(False)
        self.device = next(agent.parameters()).device
        self.seen = 0
        """Number of samples that it has learned from."""
        self._settings = settings
        self._updates = 0
        self._optimizer = torch.optim.AdamW(
            agent.parameters(),
            settings.learning_rate,
            weight_decay=settings.weight_decay,
            fused=self.device.type == "cuda",
        )

    def learn(self, loss: Tensor, count: int, share: float) -> None:
        """Update the weights by the mean loss of a minibatch, when a share of the learning is over."""
        settings = self._settings
        rate = settings.learning_rate * min(1.0, (self._updates + 1) / settings.warm_up) * max(1.0 - share, 0.01)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.live.parameters(), 1.0)
        self._optimizer.step()
        self._updates += 1
        self.seen += count
        self._move(min(settings.average, self._updates / (self._updates + 10)))

    @property
    def rate(self) -> float:
        """The learning rate of the last update."""
        return float(self._optimizer.param_groups[0]["lr"])

    def precision(self) -> torch.autocast:
        """Return the context in which encoders compute."""
        kind = self.device.type
        return torch.autocast(kind, torch.bfloat16, enabled=self._settings.bf16 and kind == "cuda")

    def state(self) -> dict[str, Any]:
        """Return all that :meth:`restore` needs."""
        return {
            "live": self.live.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "updates": self._updates,
            "seen": self.seen,
        }

    def restore(self, run: Run) -> None:
        """Continue from the ``learner`` of a run's state."""
        with run.restoring() as state:
            kept = state["learner"]
            self.live.load_state_dict(kept["live"])
            self.average.load_state_dict(kept["average"])
            self._optimizer.load_state_dict(kept["optimizer"])
            self._updates, self.seen = kept["updates"], kept["seen"]

    @torch.no_grad()
    def _move(self, past: float) -> None:
        """Move the average of weights and statistics towards the live ones."""
        kept, live = self.average.state_dict(), self.live.state_dict()
        numbers = [name for name, tensor in kept.items() if tensor.is_floating_point()]
        torch._foreach_lerp_([kept[name] for name in numbers], [live[name] for name in numbers], 1.0 - past)


class Pool:
    """The newest rows of several tensors: a new row replaces the oldest."""

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
