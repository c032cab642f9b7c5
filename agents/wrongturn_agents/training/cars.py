"""The cars that an agent learns from: two actions, tensors on the device, a divided reward, the shipped curriculum."""

import os
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from wrongturn_agents.training.action import ACTION_SPACE, controls
from wrongturn_agents.training.drive import SLOW
from wrongturn_agents.training.drives_config import CarsConfig, DrivesConfig
from wrongturn_agents.training.vec_env import WrongturnVecEnv
from wrongturn_networks import Town
from wrongturn_protocol import TRAINING_WEATHERS, Task, Traffic
from wrongturn_sim import FleetTraffic, WrongturnVectorEnv

COLLISION: Final = "collision"
"""Verdict of a drive that hit something."""
FAILURES: Final = frozenset({"off_road", COLLISION, "wrong_way"})
"""Verdicts of a failed drive."""
STANDING: Final = "not_engaged"
"""Verdict of a drive that ended because the car stood still."""
VERDICTS: Final = (*sorted(FAILURES), STANDING, "timeout")
"""Verdicts with which a drive may end in training."""
_NOTHING: Final[dict[str, Any]] = {}

Observations = dict[str, Tensor]
_STARTS = ("near_junctions", "near_bends", "inside_junctions", "lateral", "yaw", "time_limit")
_HABITS = ("hesitant", "leaders", "crossers", "waiters")
_LEAST = 3
"""A drive with traffic has at least one in so many of the most road users."""


class DrivingVecEnv(WrongturnVecEnv):
    """The cars of a town as a learner drives them.

    For a car whose drive ended, ``infos[i]`` has ``episode`` (``r``: sum of the paper's reward, not divided; ``l``:
    number of decisions), ``verdict``, ``TimeLimit.truncated`` and, only if time ran out, ``terminal_observation``.

    Args:
        num_envs: number of cars.
        settings: divisor of the reward, penalties and costs.
        keys: keys of the observation to return, in this order; all by default.
        device: device of the tensors.
        options: options of the vectorised environment. With ``backend="cuda"`` pictures are rendered on the device and
            never leave it.
    """

    def __init__(
        self,
        num_envs: int,
        settings: DrivesConfig,
        *,
        keys: Sequence[str] | None = None,
        device: torch.device | str = "cpu",
        **options: Any,
    ) -> None:
        super().__init__(num_envs, copy=False, **options)
        self.device = torch.device(device)
        whole: Any = self.envs.single_observation_space
        self.keys = tuple(whole if keys is None else keys)
        self.observation_space = spaces.Dict({key: whole[key] for key in self.keys})
        self.action_space = ACTION_SPACE
        self._divisor, self._standing_cost = settings.reward_divisor, np.float32(settings.standing_cost)
        self._penalties = dict.fromkeys(FAILURES, settings.failure_penalty) | {STANDING: settings.standing_penalty}
        self._penalties[COLLISION] += settings.collision_penalty
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, np.int64)

    def reset(self) -> Observations:
        """Start new drives."""
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self._tensors(super().reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Drive on for 0.1 s with the (n, 2) actions, steer and accelerate.

        Raises:
            RuntimeError: there are no actions.
        """
        actions = controls(self._take_actions())
        observation, rewards, terminated, truncated, found = self.envs.step(actions)
        tensors = self._tensors(observation)
        ended = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        scaled = (rewards / self._divisor).astype(np.float32)
        stands = (np.asarray(observation["speed"])[:, 0] < SLOW) & ~self._batch.waits
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
                infos[i]["terminal_observation"] = self._tensors(found["final_obs"][i])
        self._returns[ended] = 0.0
        self._lengths[ended] = 0
        return tensors, scaled, ended, infos

    @property
    def poses_by_town(self) -> list[tuple[Town, NDArray[np.float64]]]:
        """The town, and where each car is, (n, 3): x and y of the body's centre in metres, and yaw in radians."""
        return [(self._batch.town, self._batch.poses)]

    @property
    def _batch(self) -> WrongturnVectorEnv:
        assert isinstance(self.envs, WrongturnVectorEnv)
        return self.envs

    def _tensors(self, observation: Any) -> Observations:
        """Return copies on the device, because the next step overwrites the arrays."""
        return {key: torch.as_tensor(observation[key], device=self.device).clone() for key in self.keys}


def training_cars(
    num_envs: int | None = None,
    device: torch.device | str = "cpu",
    *,
    settings: DrivesConfig | None = None,
    track: str | None = None,
    keys: Sequence[str] | None = None,
    threads: int | None = None,
    seed: int | None = None,
    **options: Any,
) -> DrivingVecEnv:
    """Make cars that cruise about Town01 in the training weathers, with correct commands and the shipped curriculum.

    Drives start near junctions, near bends and inside junctions, most of them beside traffic with crossing and waiting
    cars, and rewards have the shipped costs. These are the cars of the shipped PPO agents and of MaRLn.

    ``reset()`` returns a dict of tensors on the device, (``num_envs``, ...) each. ``step(actions)`` takes an array
    (``num_envs``, 2) of steer and accelerate in [-1, 1], and returns the next tensors, rewards (``num_envs``,) float32,
    ends (``num_envs``,) bool and a list of infos. A car whose drive ended begins its next one at once, and
    ``infos[i]`` says how it ended: ``verdict``, ``episode`` (``r``, ``l``), ``TimeLimit.truncated`` and, if time ran
    out, ``terminal_observation``.

    Args:
        num_envs: number of cars; by default that of the settings, 512.
        device: device of the tensors. On CUDA the pictures are rendered there and never leave it.
        settings: starts, traffic, costs. Example: ``DrivesConfig(traffic=0.0)`` for empty streets.
        track: track of the observations: ``state``, ``camera``, ``segmentation`` or ``privileged``.
        keys: keys of the observation to return; by default the settings' keys, or all of a track that you name.
        threads: threads that share the simulation; all cores by default.
        seed: seed of the first ``reset``: car ``i`` draws from ``seed + i``.
        options: further options of :class:`~wrongturn_sim.WrongturnVectorEnv`, such as ``town``.
    """
    config = settings or DrivesConfig()
    given: dict[str, Any] = {"town": "Town01", "strict": True, "record": False, **cruises(config), **options}
    if torch.device(device).type == "cuda":
        given.setdefault("backend", "cuda")
    envs = DrivingVecEnv(
        num_envs or config.num_envs,
        config,
        keys=keys or (config.keys if track is None else None),
        device=device,
        track=track or config.track,
        threads=threads or len(os.sched_getaffinity(0)),
        **given,
    )
    if seed is not None:
        envs.seed(seed)
    return envs


def cruises(config: CarsConfig) -> dict[str, Any]:
    """Return the simulation's options for drives with the curriculum of some settings."""
    found: dict[str, Any] = {
        "task": Task.CRUISE,
        "weather": TRAINING_WEATHERS,
        "journeys": {
            **{name: getattr(config, name) for name in _STARTS},
            "window": (config.window_nearest, config.window_farthest),
        },
    }
    if config.traffic:
        least = Traffic(vehicles=config.vehicles // _LEAST, pedestrians=config.pedestrians // _LEAST)
        found["journeys"] |= {"alone": 1.0 - config.traffic, "least_traffic": least}
        found["traffic"] = Traffic(vehicles=config.vehicles, pedestrians=config.pedestrians)
        found["own_traffic"] = FleetTraffic(**{name: getattr(config, name) for name in _HABITS})
    return found
