"""Cars whose sensors and steering are not what they should be, so that an agent learns to do without."""

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from wrongturn_agents.training.cars import Observations
from wrongturn_agents.training.drives_config import WorldConfig

_STREAM: Final = 2**53
"""First number of the seeds of disturbances, which no draw gives."""


def noisy(rgb: Tensor, deviation: Tensor) -> Tensor:
    """Return pictures (n, h, w, 3) uint8 with noise of the standard deviation (n,) of each; every pixel has its own."""
    spread = torch.randn(rgb.shape, device=rgb.device, dtype=torch.float16 if rgb.is_cuda else torch.float32)
    spread *= deviation.to(spread)[:, None, None, None]
    return spread.add_(rgb).round_().clamp_(0, 255).to(torch.uint8)


class DisturbedCars(VecEnvWrapper):
    """Cars with noise in their pictures, late observations, and steering that is stronger or weaker than it should be.

    Each drive draws its own strength of each, up to the settings'. The last observation of a drive that ran out of time
    is left as it is: only its value counts.

    Args:
        cars: cars whose observations are tensors.
        settings: the greatest ``noise``, ``delay`` and ``steering``.
        seed: seed of the strengths; the noise is from torch's own generator.
    """

    def __init__(self, cars: VecEnv, settings: WorldConfig, seed: int | None = None) -> None:
        super().__init__(cars)
        self._settings = settings
        self._random = np.random.default_rng(None if seed is None else [_STREAM, seed])
        self._noise, self._gain = np.zeros(self.num_envs), np.ones(self.num_envs)
        self._delay, self._age = np.zeros(self.num_envs, np.int64), np.zeros(self.num_envs, np.int64)
        self._past: deque[Observations] = deque(maxlen=settings.delay + 1)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the strengths and that of the drives."""
        self._random = np.random.default_rng(None if seed is None else [_STREAM, seed])
        seeds: Sequence[int | None] = self.venv.seed(seed)
        return seeds

    def reset(self) -> Observations:
        """Start new drives."""
        seen: Any = self.venv.reset()
        self._begin(np.ones(self.num_envs, np.bool_))
        return self._seen(seen)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for :meth:`step_wait`, with the steering that the wheels make of theirs."""
        turned = np.array(actions)
        turned[:, 0] = np.clip(turned[:, 0], -1.0, 1.0) * self._gain
        self.venv.step_async(turned)

    def step_wait(self) -> VecEnvStepReturn:
        """Drive on for 0.1 s."""
        seen, rewards, ended, infos = self.venv.step_wait()
        self._age += 1
        self._begin(ended)
        return self._seen(seen), rewards, ended, infos

    def _begin(self, which: NDArray[np.bool_]) -> None:
        """Draw how the drives that begin are disturbed."""
        count, settings = int(which.sum()), self._settings
        self._noise[which] = self._random.uniform(0.0, settings.noise, count)
        self._delay[which] = self._random.integers(0, settings.delay + 1, count)
        self._gain[which] = 1.0 + self._random.uniform(-settings.steering, settings.steering, count)
        self._age[which] = 0

    def _seen(self, observation: Any) -> Observations:
        seen = dict(observation)
        if self._settings.noise and "rgb" in seen:
            seen["rgb"] = noisy(seen["rgb"], torch.as_tensor(self._noise))
        if not self._settings.delay:
            return seen
        self._past.appendleft(seen)
        late = torch.as_tensor(np.minimum(self._delay, self._age))
        for lag in range(1, len(self._past)):
            rows = late == lag
            if rows.any():
                seen = {
                    key: torch.where(rows.to(now.device).view(-1, *[1] * (now.ndim - 1)), self._past[lag][key], now)
                    for key, now in seen.items()
                }
        return seen
