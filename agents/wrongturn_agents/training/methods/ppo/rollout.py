"""A rollout on the device, whose pictures stay bytes: what the policy sees, and the buffer that keeps it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.training.cars import Observations
from wrongturn_agents.training.methods.ppo.config import PPOConfig

FEATURES = "features"
"""Key of a frozen encoder's features, in place of the picture."""


class SeenVecEnv(VecEnvWrapper):
    """Environments as the policy sees them.

    The buffer keeps exactly the frame that the policy acted on. So augmentation is part of the world, not of the loss,
    and the policy's ratio is 1 before anything is learned. If the encoder is frozen, each frame is encoded once, and
    RGB is not kept.
    """

    def __init__(self, envs: VecEnv, agent: ActorCritic, config: PPOConfig) -> None:
        self._agent, self._config = agent, config
        seen: Any = envs.observation_space
        space = dict(seen.spaces)
        if config.pretrained:
            space.pop("rgb")
            space[FEATURES] = spaces.Box(-np.inf, np.inf, (agent.encoder.width,), np.float16)
        super().__init__(envs, observation_space=spaces.Dict(space))

    def reset(self) -> Observations:
        """Start new drives."""
        return self._seen(self.venv.reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Step the environments and return what the policy sees."""
        observation, rewards, dones, infos = self.venv.step_wait()
        last = [i for i in np.flatnonzero(dones).tolist() if "terminal_observation" in infos[i]]
        if last and self._config.pretrained:
            given = [infos[i]["terminal_observation"] for i in last]
            features = self._encoded({"rgb": torch.stack([one["rgb"] for one in given])})
            for i, one, row in zip(last, given, features, strict=True):
                infos[i]["terminal_observation"] = {**_without_rgb(one), FEATURES: row}
        return self._seen(observation), rewards, dones, infos

    @torch.no_grad()
    def _seen(self, observation: Observations) -> Observations:
        seen = dict(self._agent.disturb(observation)) if self._config.disturbed else observation
        return {**_without_rgb(seen), FEATURES: self._encoded(seen)} if self._config.pretrained else seen

    @torch.no_grad()
    def _encoded(self, observation: Observations) -> Tensor:
        kind = observation["rgb"].device.type
        with torch.autocast(kind, torch.bfloat16, enabled=self._config.bf16 and kind == "cuda"):
            return self._agent.encode(observation).to(torch.bfloat16)


def _without_rgb(observation: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in observation.items() if name != "rgb"}


class DeviceRolloutBuffer(RolloutBuffer):
    """``DictRolloutBuffer`` with tensors on one device, allocated once.

    Stable-Baselines3's own buffer keeps numpy arrays. It would copy every minibatch of pictures to the device, and
    convert them to float32, four times their size.
    """

    observation_space: spaces.Dict

    def reset(self) -> None:
        """Start a new rollout in the same tensors."""
        if not hasattr(self, "log_probs"):
            self._allocate()
        self.pos = 0
        self.full = False
        self.generator_ready = False

    def _allocate(self) -> None:
        shape = (self.buffer_size, self.n_envs)

        def make(*more: int, kind: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros((*shape, *more), dtype=kind, device=self.device)

        self.observations: Observations = {
            name: make(*(space.shape or ()), kind=_kind(space)) for name, space in self.observation_space.items()
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
        for name, tensor in self.observations.items():
            tensor[self.pos].copy_(torch.as_tensor(obs[name]))
        kept = (self.actions, self.rewards, self.episode_starts, self.values, self.log_probs)
        for tensor, given in zip(kept, (action, reward, episode_start, value.flatten(), log_prob), strict=True):
            tensor[self.pos].copy_(torch.as_tensor(given))
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def compute_returns_and_advantage(self, last_values: Tensor, dones: NDArray[np.bool_]) -> None:
        """Fill returns and advantages with GAE (Schulman et al. 2016), by the values after the last decision."""
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

    def get(self, batch_size: int | None = None) -> Iterator[DictRolloutBufferSamples]:
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
            observations = {name: tensor[chosen] for name, tensor in flat.items()}
            yield DictRolloutBufferSamples(observations, *(tensor[chosen] for tensor in rest))


def _kind(space: spaces.Space[Any]) -> torch.dtype:
    """Return the type of a key's tensors. Features are float16 in their space: gymnasium knows no bfloat16."""
    return torch.bfloat16 if space.dtype == np.float16 else torch.from_numpy(np.empty(0, space.dtype)).dtype
