"""Many cars to learn from: two actions, tensors on the device, a divided reward and penalties for failures."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from wrongturn_agents.training.action import ACTION_SPACE, controls
from wrongturn_agents.training.stopwatch import Stopwatch
from wrongturn_agents.training.vec_env import WrongturnVecEnv
from wrongturn_sim import WrongturnVectorEnv

COLLISION: Final = "collision"
"""Verdict of a drive that hit something."""
FAILURES: Final = frozenset({"off_road", COLLISION, "wrong_way"})
"""Verdicts of a failed drive."""
STANDING: Final = "not_engaged"
"""Verdict of a drive that ended because the car stood still."""
VERDICTS: Final = (*sorted(FAILURES), STANDING, "timeout")
"""Verdicts with which a drive may end in training."""
SLOW: Final = 0.3
"""A slower car counts as standing, m/s."""
_NOTHING: Final[dict[str, Any]] = {}

Observations = dict[str, Tensor]


class DrivingVecEnv(WrongturnVecEnv):
    """The cars of a town as a learner drives them.

    For a car whose drive ended, ``infos[i]`` has ``episode`` (``r``: sum of the paper's reward, not divided; ``l``:
    number of decisions), ``verdict``, ``TimeLimit.truncated`` and, only if time ran out, ``terminal_observation``.

    Args:
        num_envs: number of cars.
        keys: keys of the observation to return, in this order; all by default.
        device: device of the tensors.
        reward_divisor: divisor of the reward.
        failure_penalty: taken off the divided reward when a drive fails.
        collision_penalty: taken off as well when it ends in a collision.
        standing_penalty: taken off the divided reward when a drive ends because the car stands still.
        standing_cost: taken off the divided reward of each decision after which the car stands, unless others block
            its way.
        stopwatch: counts rendering as ``render`` and the rest as ``env``.
        options: options of the vectorised environment. With ``backend="cuda"`` pictures are rendered on the device and
            never leave it.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        keys: Sequence[str] | None = None,
        device: torch.device | str = "cpu",
        reward_divisor: float = 1.0,
        failure_penalty: float = 0.0,
        collision_penalty: float = 0.0,
        standing_penalty: float = 0.0,
        standing_cost: float = 0.0,
        stopwatch: Stopwatch | None = None,
        **options: Any,
    ) -> None:
        super().__init__(num_envs, copy=False, **options)
        self.device = torch.device(device)
        self.stopwatch = stopwatch or Stopwatch(self.device)
        whole: Any = self.envs.single_observation_space
        self.keys = tuple(whole if keys is None else keys)
        self.observation_space = spaces.Dict({key: whole[key] for key in self.keys})
        self.action_space = ACTION_SPACE
        self._divisor = reward_divisor
        self._penalties = dict.fromkeys(FAILURES, failure_penalty) | {STANDING: standing_penalty}
        self._penalties[COLLISION] += collision_penalty
        self._standing_cost = np.float32(standing_cost)
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        self._shared: dict[str, tuple[Any, Tensor]] = {}
        self._watch_pictures()

    def reset(self) -> Observations:
        """Start new drives."""
        self._returns[:] = 0.0
        self._lengths[:] = 0
        with self.stopwatch.part("env"):
            return self._tensors(super().reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Drive on for 0.1 s with the (n, 2) actions, steer and accelerate.

        Raises:
            RuntimeError: there are no actions.
        """
        if self._waiting is None:
            raise RuntimeError("step_wait: there are no actions; call step_async first, or step")
        actions, self._waiting = self._waiting, None
        with self.stopwatch.part("env"):
            observation, rewards, terminated, truncated, found = self.envs.step(controls(actions))
            tensors = self._tensors(observation)
        ended = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        scaled = (rewards / self._divisor).astype(np.float32)
        stands = np.asarray(observation["speed"])[:, 0] < SLOW
        stands &= ~self._waits()
        scaled -= self._standing_cost * (stands & ~ended)  # an ended car's speed is already that of its next drive
        infos: list[dict[str, Any]] = [_NOTHING] * self.num_envs
        for i in np.flatnonzero(ended).tolist():
            verdict = found["final_info"]["verdict"][i]
            infos[i] = {
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
                "verdict": verdict,
                "TimeLimit.truncated": bool(truncated[i]),
            }
            scaled[i] -= self._penalties.get(verdict, 0.0)
            if truncated[i]:
                infos[i]["terminal_observation"] = self._terminal(found["final_obs"][i])
        self._returns[ended] = 0.0
        self._lengths[ended] = 0
        return tensors, scaled, ended, infos

    @property
    def poses(self) -> NDArray[np.float64]:
        """Where each car is, (n, 3): x and y of the body's centre in metres, and yaw in radians."""
        assert isinstance(self.envs, WrongturnVectorEnv)
        return self.envs.poses

    def _waits(self) -> Any:
        """Return whether others block each car's way, (n,)."""
        return getattr(self.envs, "waits", np.False_)

    def _terminal(self, observation: dict[str, Any]) -> dict[str, Tensor]:
        return {key: torch.as_tensor(observation[key], device=self.device) for key in self.keys}

    def _tensors(self, observation: Any) -> Observations:
        """Return copies on the device, because the next step overwrites the arrays."""
        return {key: self._shared_tensor(key, observation[key]).to(self.device, copy=True) for key in self.keys}

    def _shared_tensor(self, key: str, array: Any) -> Tensor:
        """Return a tensor that shares an array's memory; the environments reuse their arrays."""
        known, tensor = self._shared.get(key, (None, None))
        if known is not array or tensor is None:
            there = hasattr(type(array), "__cuda_array_interface__")
            tensor = torch.as_tensor(array, device=self.device if there else None)
            self._shared[key] = array, tensor
        return tensor

    def _watch_pictures(self) -> None:
        """Count the camera's work as ``render``."""
        camera = getattr(self.envs, "_camera", None)
        if camera is None:
            return
        render = camera.render

        def timed(*args: Any, **kwargs: Any) -> None:
            with self.stopwatch.part("render"):
                render(*args, **kwargs)

        camera.render = timed
