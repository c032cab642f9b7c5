"""Untrained policies of Stable-Baselines3 on our spaces, and an environment that shows what its space allows."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from wrongturn_agents.training.action import ACTION_SPACE
from wrongturn_protocol import Track
from wrongturn_protocol.observations import observation_space


class RandomTown(gymnasium.Env[Any, Any]):
    """Shows random observations of a track; the reward is the sum of the action."""

    def __init__(
        self,
        track: Track = Track.STATE,
        actions: spaces.Space[Any] = ACTION_SPACE,
        seen: spaces.Space[Any] | None = None,
    ) -> None:
        self.observation_space = seen or observation_space(track)
        self.action_space = actions

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.observation_space.sample(), float(np.sum(action)), False, bool(self.np_random.random() < 0.1), {}


class Extractor(BaseFeaturesExtractor):
    """Takes the speed and the steering."""

    def __init__(self, observation_space: spaces.Space[Any]) -> None:
        super().__init__(observation_space, features_dim=2)

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        return torch.cat([observation["speed"] / 10, observation["steering"]], 1)


class Draws(Extractor):
    """Adds a random number, so that no two actions are the same."""

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        return super().forward(observation) + 100 * torch.rand_like(observation["speed"])


class Branches(Extractor):
    """Decides by a value, which no graph can."""

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        features = super().forward(observation)
        return features if observation["speed"].item() > 3 else -features


def ppo(env: Any, **options: Any) -> PPO:
    """Return an untrained PPO whose actions are not all about 0."""
    return made(PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, device="cpu", seed=1, **options))


def made(model: Any) -> Any:
    """Make the last layer of an actor-critic loud; else an untrained one does about the same everywhere."""
    if hasattr(model.policy, "action_net"):
        with torch.no_grad():
            model.policy.action_net.weight.mul_(50.0)
    return model


def saved(model: BaseAlgorithm, file: Path) -> Path:
    """Save a model, and return the file."""
    model.save(file)
    return file
