"""The cars that an agent learns from: the batch of :class:`DrivingVecEnv` with the shipped curriculum."""

import os
from collections.abc import Sequence
from typing import Any

import torch

from wrongturn_agents.training.drives_config import CarsConfig, DrivesConfig
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch
from wrongturn_protocol import TRAINING_WEATHERS, Task, Traffic
from wrongturn_sim import FleetTraffic

_STARTS = ("near_junctions", "near_bends", "inside_junctions", "lateral", "yaw", "time_limit")
_HABITS = ("hesitant", "leaders", "crossers", "waiters")
_LEAST = 3
"""A drive with traffic has at least one in so many of the most road users."""


def training_cars(
    num_envs: int | None = None,
    device: torch.device | str = "cpu",
    *,
    settings: DrivesConfig | None = None,
    track: str | None = None,
    keys: Sequence[str] | None = None,
    threads: int | None = None,
    seed: int | None = None,
    stopwatch: Stopwatch | None = None,
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
        stopwatch: counts rendering as ``render`` and the rest as ``env``.
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
        stopwatch=stopwatch,
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
