"""The cars of a training: the newest pictures of each, encoded, and the noise that it explores with."""

from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from wrongturn_agents.training.cars import Observations
from wrongturn_marln.config import MarlnConfig
from wrongturn_marln.network import ACTIONS, FRAMES, Marln
from wrongturn_marln.replay import Decisions


class FrameStack:
    """Keeps the last four pictures of each car. At a drive's start the first one stands for those before it."""

    def __init__(self) -> None:
        self._frames: Tensor | None = None

    def push(self, rgb: Tensor, begun: Tensor) -> Tensor:
        """Return the stacks (n, 4, 64, 192, 3) uint8, the newest last; the next call overwrites them.

        ``rgb`` is (n, 64, 192, 3) uint8, and ``begun`` (n,) whether the picture is the first of a drive.
        """
        again = rgb.unsqueeze(1).expand(-1, FRAMES, -1, -1, -1)
        if self._frames is None:
            self._frames = again.clone()
            return self._frames
        self._frames = torch.cat([self._frames[:, 1:], rgb.unsqueeze(1)], 1)
        rows = begun.nonzero().squeeze(1)
        self._frames[rows] = again[rows]
        return self._frames


class _Seen(NamedTuple):
    features: Tensor
    measured: Tensor
    command: Tensor


class Cars:
    """Drives all cars by a network's best actions, with noise. Its encoder is frozen."""

    def __init__(self, envs: VecEnv, model: Marln, config: MarlnConfig, generator: torch.Generator) -> None:
        self.envs, self._model, self._config = envs, model, config
        self._generator, self._device = generator, generator.device
        self._stack = FrameStack()
        self._table = np.array(ACTIONS, np.float32)
        self._noise = model.values.heads.draw_noise(envs.num_envs, generator)
        self._draws = model.augmentation.draw(envs.num_envs, self._device, generator)
        self._steps = 0
        begun = torch.ones(envs.num_envs, dtype=torch.bool, device=self._device)
        self._seen = self._look(envs.reset(), begun)

    @torch.no_grad()
    def drive(self) -> tuple[Decisions, list[dict[str, Any]]]:
        """Drive on for 0.1 s; return what was seen, done and earned, and the infos of the drives that ended."""
        seen = self._seen
        self._renew()
        action = self._model.values.choose(*seen, self._noise)
        chosen = self._table[action.cpu().numpy()]
        observation, reward, done, infos = self.envs.step(chosen)
        cut = np.array([bool(info.get("TimeLimit.truncated")) for info in infos])
        over = torch.as_tensor(done, device=self._device)
        decisions = Decisions(
            *seen,
            action=action,
            reward=torch.as_tensor(reward, device=self._device),
            ended=torch.as_tensor(done & ~cut, device=self._device),
            cut=torch.as_tensor(cut, device=self._device),
        )
        self._seen = self._look(observation, over)
        return decisions, [infos[i] for i in np.flatnonzero(done).tolist()]

    def _renew(self) -> None:
        """Draw noise, and the change of pictures, for the cars whose turn it is."""
        every = self._config.noise_decisions
        turn = slice(self._steps % every, None, every)
        rows = len(self._noise[turn])
        self._noise[turn] = self._model.values.heads.draw_noise(rows, self._generator)
        self._draws[turn] = self._model.augmentation.draw(rows, self._device, self._generator)
        self._steps += 1

    @torch.no_grad()
    def _look(self, observation: Observations, begun: Tensor) -> _Seen:
        config = self._config
        rgb = observation["rgb"]
        if config.augment:
            rgb = self._model.augmentation.changed(rgb, self._draws)
        frames = self._stack.push(rgb, begun)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=config.bf16 and self._device.type == "cuda"):
            features = self._model.encode(frames).to(torch.bfloat16)
        measured = torch.cat([observation["speed"], observation["steering"]], 1)
        return _Seen(features, measured, observation["command"][:, 0])
