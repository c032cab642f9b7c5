"""A rollout on the device, whose pictures stay bytes."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from torch import Tensor

from wrongturn_agents.training.driving_env import Observations
from wrongturn_agents.training.stopwatch import Stopwatch

_KINDS = {
    np.dtype(np.uint8): torch.uint8,
    np.dtype(np.int64): torch.int64,
    np.dtype(np.float32): torch.float32,
    np.dtype(np.float16): torch.bfloat16,  # features; gymnasium knows no bfloat16
}


class Samples(NamedTuple):
    """A minibatch of b frames, on the device."""

    observations: Observations
    """(b, ...) for each key, in the dtypes of the observation space."""
    actions: Tensor
    """(b, 2) as sampled, before clipping."""
    old_values: Tensor
    """(b,)"""
    old_log_prob: Tensor
    """(b,)"""
    advantages: Tensor
    """(b,)"""
    returns: Tensor
    """(b,)"""


class DeviceRolloutBuffer(RolloutBuffer):
    """``DictRolloutBuffer`` with tensors on one device, allocated once.

    Stable-Baselines3's own buffer keeps numpy arrays. It would copy every minibatch of pictures to the device, and
    convert them to float32, four times their size.
    """

    observation_space: spaces.Dict

    def __init__(self, *arguments: Any, stopwatch: Stopwatch | None = None, **options: Any) -> None:
        self._stopwatch = stopwatch or Stopwatch(torch.device("cpu"))
        super().__init__(*arguments, **options)

    def reset(self) -> None:
        """Start a new rollout in the same tensors."""
        if not hasattr(self, "_tensors"):
            self._allocate()
        self.pos = 0
        self.full = False
        self.generator_ready = False

    def _allocate(self) -> None:
        shape = (self.buffer_size, self.n_envs)

        def make(*more: int, kind: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros((*shape, *more), dtype=kind, device=self.device)

        self._tensors = True
        self.observations: Observations = {
            name: make(*(space.shape or ()), kind=_KINDS[space.dtype]) for name, space in self.observation_space.items()
        }
        self.actions = make(self.action_dim)
        self.rewards, self.returns, self.advantages = make(), make(), make()
        self.episode_starts, self.values, self.log_probs = make(), make(), make()

    def add(
        self,
        obs: dict[str, Tensor | NDArray[Any]],
        action: NDArray[np.float32],
        reward: NDArray[np.float32],
        episode_start: NDArray[np.bool_],
        value: Tensor,
        log_prob: Tensor,
    ) -> None:
        """Store one decision of all environments, (n_envs, ...) each."""
        with self._stopwatch.part("buffer"):
            for name, tensor in self.observations.items():
                tensor[self.pos].copy_(torch.as_tensor(obs[name]))
            self.actions[self.pos].copy_(torch.as_tensor(action))
            self.rewards[self.pos].copy_(torch.as_tensor(reward))
            self.episode_starts[self.pos].copy_(torch.as_tensor(episode_start))
            self.values[self.pos].copy_(value.flatten())
            self.log_probs[self.pos].copy_(log_prob)
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def compute_returns_and_advantage(self, last_values: Tensor, dones: NDArray[np.bool_]) -> None:
        """Fill returns and advantages with GAE (Schulman et al. 2016).

        Args:
            last_values: (n_envs,) or (n_envs, 1): values after the last decision.
            dones: (n_envs,): whether an episode ended with the last decision.
        """
        following = last_values.flatten().float()
        lasting = 1.0 - torch.as_tensor(dones, dtype=torch.float32, device=self.device)
        advantage = torch.zeros_like(following)
        for step in reversed(range(self.buffer_size)):
            delta = self.rewards[step] + self.gamma * following * lasting - self.values[step]
            advantage = delta + self.gamma * self.gae_lambda * lasting * advantage
            self.advantages[step] = advantage
            following = self.values[step]
            lasting = 1.0 - self.episode_starts[step]
        torch.add(self.advantages, self.values, out=self.returns)

    def get(self, batch_size: int | None = None) -> Iterator[Samples]:
        """Yield every frame once, in minibatches in random order (from the device's torch generator)."""
        assert self.full, "the rollout is not complete"
        count = self.buffer_size * self.n_envs
        order = torch.randperm(count, device=self.device)
        flat = {name: tensor.flatten(0, 1) for name, tensor in self.observations.items()}
        rest = [
            tensor.flatten(0, 1)
            for tensor in (self.actions, self.values, self.log_probs, self.advantages, self.returns)
        ]
        for chosen in torch.split(order, batch_size or count):
            yield Samples({name: tensor[chosen] for name, tensor in flat.items()}, *(tensor[chosen] for tensor in rest))
