"""Observations as the policy sees them: augmented or masked, and encoded if the encoder is frozen."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from wrongturn_agents.training.driving_env import Observations
from wrongturn_agents.training.stopwatch import Stopwatch

FEATURES = "features"
"""Key of a frozen encoder's features, in place of the picture."""


class SeenVecEnv(VecEnvWrapper):
    """Environments as the policy sees them.

    The buffer keeps exactly the frame that the policy acted on. So augmentation is part of the world, not of the loss,
    and the policy's ratio is 1 before anything is learned.

    Args:
        disturb: changes pictures at random, or masks classes. None leaves them.
        encode: the frozen encoder, from observations to (b, width). Each frame is encoded once, and RGB is not kept.
        stopwatch: counts all of this as ``encode``.
    """

    def __init__(
        self,
        envs: VecEnv,
        *,
        disturb: Callable[[Observations], Mapping[str, Tensor]] | None = None,
        encode: Callable[[Observations], Tensor] | None = None,
        width: int = 0,
        stopwatch: Stopwatch | None = None,
    ) -> None:
        self._disturb = disturb
        self._encode = encode
        self._stopwatch = stopwatch or Stopwatch(torch.device("cpu"))
        space = dict(envs.observation_space.spaces)
        if encode is not None:
            space.pop("rgb")
            space[FEATURES] = spaces.Box(-np.inf, np.inf, (width,), np.float16)
        super().__init__(envs, observation_space=spaces.Dict(space))

    def reset(self) -> Observations:
        """Start new drives."""
        return self._seen(self.venv.reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Step the environments and return what the policy sees."""
        observation, rewards, dones, infos = self.venv.step_wait()
        last = [i for i in np.flatnonzero(dones).tolist() if "terminal_observation" in infos[i]]
        if last and self._encode is not None:
            given = [infos[i]["terminal_observation"] for i in last]
            features = self._encoded({"rgb": torch.stack([one["rgb"] for one in given])})
            for i, one, row in zip(last, given, features, strict=True):
                infos[i]["terminal_observation"] = {**_without_rgb(one), FEATURES: row}
        return self._seen(observation), rewards, dones, infos

    @torch.no_grad()
    def _seen(self, observation: Observations) -> Observations:
        with self._stopwatch.part("encode"):
            seen = observation if self._disturb is None else dict(self._disturb(observation))
            return seen if self._encode is None else {**_without_rgb(seen), FEATURES: self._encoded(seen)}

    @torch.no_grad()
    def _encoded(self, observation: Observations) -> Tensor:
        assert self._encode is not None
        return self._encode(observation).to(torch.bfloat16)


def _without_rgb(observation: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in observation.items() if name != "rgb"}
