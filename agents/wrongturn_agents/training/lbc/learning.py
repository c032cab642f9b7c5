"""What both agents' learning shares: samples, updates, and the average of the weights."""

import copy
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from wrongturn_agents.models.lbc import WaypointAgent
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.lbc.config import LBCConfig


class Samples:
    """The newest samples, on the device.

    Args:
        size: most samples that are kept.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._kept: dict[str, Tensor] = {}
        self.added = 0
        """Number of samples so far, with those that are gone."""

    def __len__(self) -> int:
        return min(self.added, self._size)

    def add(self, samples: Mapping[str, Tensor]) -> None:
        """Add samples (n, ...) in the place of the oldest."""
        count = len(next(iter(samples.values())))
        for name, given in samples.items():
            if name not in self._kept:
                self._kept[name] = torch.empty((self._size, *given.shape[1:]), dtype=given.dtype, device=given.device)
            rows = (torch.arange(count, device=given.device) + self.added) % self._size
            self._kept[name][rows] = given
        self.added += count

    def draw(self, count: int) -> dict[str, Tensor]:
        """Return samples at random."""
        device = next(iter(self._kept.values())).device
        rows = torch.randint(len(self), (count,), device=device)
        return {name: kept[rows] for name, kept in self._kept.items()}


class Learner:
    """An agent that learns, and the average of its weights, which drives.

    Args:
        agent: the agent, on its device.
        config: learning rate, weight decay and average.
    """

    def __init__(self, agent: WaypointAgent, config: LBCConfig) -> None:
        self.live = agent.train()
        self.average = copy.deepcopy(agent).eval().requires_grad_(False)
        self.device = next(agent.parameters()).device
        self.seen = 0
        """Number of samples that it has learned from."""
        self._config = config
        self._updates = 0
        self._optimizer = torch.optim.AdamW(
            agent.parameters(), config.learning_rate, weight_decay=config.weight_decay, fused=self.device.type == "cuda"
        )

    def learn(self, loss: Tensor, count: int, share: float) -> None:
        """Update the weights.

        Args:
            loss: mean over a minibatch.
            count: samples in the minibatch.
            share: how much of the learning is over, from 0 to 1.
        """
        config = self._config
        rate = config.learning_rate * min(1.0, (self._updates + 1) / config.warm_up) * max(1.0 - share, 0.01)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.live.parameters(), 1.0)
        self._optimizer.step()
        self._updates += 1
        self.seen += count
        self._move(min(config.average, self._updates / (self._updates + 10)))

    @property
    def rate(self) -> float:
        """The learning rate of the last update."""
        return float(self._optimizer.param_groups[0]["lr"])

    def state(self) -> dict[str, Any]:
        """Return all that :meth:`restore` needs."""
        return {
            "live": self.live.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "updates": self._updates,
            "seen": self.seen,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a state.

        Raises:
            TrainingError: the state is of other networks.
        """
        try:
            self.live.load_state_dict(state["live"])
            self.average.load_state_dict(state["average"])
            self._optimizer.load_state_dict(state["optimizer"])
            self._updates, self.seen = state["updates"], state["seen"]
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise TrainingError(
                "resume: the state is of other networks than this version's; begin anew in another directory"
            ) from error

    @torch.no_grad()
    def _move(self, past: float) -> None:
        """Move the average of weights and statistics towards the live ones."""
        kept, live = self.average.state_dict(), self.live.state_dict()
        numbers = [name for name, tensor in kept.items() if tensor.is_floating_point()]
        torch._foreach_lerp_([kept[name] for name in numbers], [live[name] for name in numbers], 1.0 - past)


def precision(config: LBCConfig, device: torch.device) -> torch.autocast:
    """Return the context in which encoders compute."""
    return torch.autocast(device.type, torch.bfloat16, enabled=config.bf16 and device.type == "cuda")
