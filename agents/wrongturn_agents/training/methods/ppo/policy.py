"""The policy that Stable-Baselines3 trains: one of our networks as an ``ActorCriticPolicy``."""

import math
from collections.abc import Callable
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor

from wrongturn_agents.models import ActorCritic, Homoscedastic
from wrongturn_agents.training.cars import Observations
from wrongturn_agents.training.methods.ppo.config import PPOConfig
from wrongturn_agents.training.methods.ppo.rollout import FEATURES

_LOG_ROOT = 0.5 * math.log(2.0 * math.pi)


class WrongturnPolicy(ActorCriticPolicy):
    """An actor-critic of ours, which ``model`` returns, with a Gaussian over steer and accelerate."""

    model: ActorCritic
    homoscedastic: Homoscedastic

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Box,
        lr_schedule: Callable[[float], float],
        *,
        model: Callable[[], ActorCritic],
        config: PPOConfig,
        **_: Any,
    ) -> None:
        self._make, self._config = model, config
        # An own extractor of features is not needed: this one has no weights.
        super().__init__(observation_space, action_space, lr_schedule, net_arch={})

    def _build(self, lr_schedule: Callable[[float], float]) -> None:
        config = self._config
        self.model = self._make()
        if config.auxiliary:
            self.homoscedastic = Homoscedastic()
        shares = {
            "model.encoder.network.": config.encoder_learning_rate,
            "model.encoder.projection.": config.projection_learning_rate,
        }
        groups: dict[float, list[torch.nn.Parameter]] = {1.0: []}
        for name, parameter in self.named_parameters():
            if parameter.requires_grad:
                share = next((share for part, share in shares.items() if name.startswith(part)), 1.0)
                groups.setdefault(share, []).append(parameter)
        rate = lr_schedule(1)
        self.optimizer = torch.optim.Adam(
            [{"params": group, "share": share, "lr": rate * share} for share, group in groups.items()], eps=1e-5
        )
        self._encode: Callable[[Observations], Tensor] = self.model.encode
        if config.compile:
            self._encode = torch.compile(self.model.encode)

    def features(self, observation: Observations) -> Tensor:
        """Return features (b, F) float32 of pictures, or of a frozen encoder's output."""
        return self.model.join(self.encode(observation), observation)

    def encode(self, observation: Observations) -> Tensor:
        """Encode pictures as (b, width). Observations that are already encoded pass through."""
        if FEATURES in observation:
            return observation[FEATURES]
        with self.precision(observation):
            return self._encode(observation)

    def precision(self, observation: Observations) -> torch.autocast:
        """Return the context in which the encoder computes: bfloat16 on CUDA. The rest always computes in float32."""
        kind = observation["speed"].device.type
        return torch.autocast(kind, torch.bfloat16, enabled=self._config.bf16 and kind == "cuda")

    def forward(self, obs: Observations, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Return actions (b, 2), values (b,) and log-probabilities (b,)."""
        mean, values = self.model(self.features(obs), obs["command"])
        actions = mean if deterministic else mean + torch.exp(self.model.log_std) * torch.randn_like(mean)
        return actions, values, self._log_prob(mean, actions)

    def evaluate_actions(self, obs: Observations, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return values (b,), log-probabilities (b,) of these actions, and the entropy ()."""
        mean, values = self.model(self.features(obs), obs["command"])
        entropy = (self.model.log_std + 0.5 + _LOG_ROOT).sum()
        return values, self._log_prob(mean, actions), entropy

    def predict_values(self, obs: Observations) -> Tensor:
        """Return values (b,)."""
        value: Tensor = self.model.value(self.features(obs), obs["command"])
        return value

    def obs_to_tensor(self, observation: dict[str, Any]) -> tuple[Observations, bool]:
        """Return a single observation as a batch of one."""
        device = self.model.log_std.device
        return {name: torch.as_tensor(value, device=device)[None] for name, value in observation.items()}, False

    def _log_prob(self, mean: Tensor, actions: Tensor) -> Tensor:
        # Not with torch.distributions: it checks its arguments, which waits for the device.
        log_std = self.model.log_std
        return (-0.5 * ((actions - mean) * torch.exp(-log_std)) ** 2 - log_std - _LOG_ROOT).sum(-1)
