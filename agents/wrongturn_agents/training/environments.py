"""The environments in which an agent learns."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.training.config import PPOConfig
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.seen_env import SeenVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch
from wrongturn_protocol import TRAINING_WEATHERS, Traffic
from wrongturn_sim import FleetTraffic

_JOURNEYS = ("near_junctions", "near_bends", "inside_junctions", "lateral", "yaw", "time_limit")
_HABITS = ("hesitant", "leaders", "crossers", "waiters")
_LEAST = 3
"""A drive with traffic has at least one in so many of the most road users."""


def environments(config: PPOConfig, agent: ActorCritic, stopwatch: Stopwatch, *, threads: int) -> SeenVecEnv:
    """Make cars that cruise about Town01 in the training weathers, with correct commands, as the agent sees them.

    Args:
        config: number of cars, their starts, traffic and rewards.
        agent: agent on the device of the pictures. It augments them, and encodes them if its encoder is frozen.
        stopwatch: counts the environments, the pictures and the frozen encoder.
        threads: threads that share the simulation.
    """
    device = agent.log_std.device
    driving = driving_envs(config, device, stopwatch, threads=threads)
    return SeenVecEnv(
        driving,
        disturb=agent.disturb if config.disturbed else None,
        encode=_in_precision(agent.encode, config, device) if config.frozen else None,
        width=agent.encoder.width,
        stopwatch=stopwatch,
    )


def driving_envs(
    config: DrivesConfig, device: torch.device, stopwatch: Stopwatch, *, threads: int, **options: Any
) -> DrivingVecEnv:
    """Make cars that cruise about Town01 in the training weathers, with correct commands.

    Args:
        config: number of cars, their starts, traffic and rewards.
        device: device of the pictures.
        stopwatch: counts the environments and the pictures.
        threads: threads that share the simulation.
        options: other options of the vectorised environment.
    """
    given: dict[str, Any] = {
        "keys": config.keys,
        "reward_divisor": config.reward_divisor,
        "failure_penalty": config.failure_penalty,
        "collision_penalty": config.collision_penalty,
        "standing_penalty": config.standing_penalty,
        "standing_cost": config.standing_cost,
        "track": config.track,
        "journeys": {
            **{name: getattr(config, name) for name in _JOURNEYS},
            "window": (config.window_nearest, config.window_farthest),
            **_company(config),
        },
        **_traffic(config),
        **_rendered_on(device),
    }
    return DrivingVecEnv(
        config.num_envs,
        device=device,
        stopwatch=stopwatch,
        town="Town01",
        task="cruise",
        strict=True,
        record=False,
        weather=TRAINING_WEATHERS,
        threads=threads,
        **{**given, **options},
    )


def wandering_envs(config: DrivesConfig, device: torch.device, *, threads: int, **journeys: float) -> DrivingVecEnv:
    """Make cars by which an encoder learns to see before it drives: they start anywhere, off the lane and askew.

    If the config has traffic, all drives have the most of it: the policy cannot see what a frozen encoder never saw.

    Args:
        config: number of cars, and traffic.
        device: device of the pictures.
        threads: threads that share the simulation.
        journeys: further options of the drives, such as ``time_limit``.
    """
    return driving_envs(
        config,
        device,
        # A stopwatch of the GPU would wait after each step, and learning could not continue meanwhile.
        Stopwatch(torch.device("cpu")),
        threads=threads,
        track="segmentation",
        keys=("rgb", "segmentation"),
        journeys={"near_bends": 0.25, "near_junctions": 0.4, "lateral": 0.7, "yaw": 0.2, **journeys},
    )


def wander(random: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Draw actions (count, 2) with which such cars drive about: steer and accelerate."""
    return np.stack([random.normal(0.0, 0.2, count), random.uniform(-0.2, 0.8, count)], -1)


def _company(config: DrivesConfig) -> dict[str, Any]:
    """Return which of the cruises have how many other road users."""
    if not config.traffic:
        return {}
    least = Traffic(vehicles=config.vehicles // _LEAST, pedestrians=config.pedestrians // _LEAST)
    return {"alone": 1.0 - config.traffic, "least_traffic": least}


def _traffic(config: DrivesConfig) -> dict[str, Any]:
    """Return the vectorised environment's options for other road users."""
    if not config.traffic:
        return {}
    return {
        "traffic": Traffic(vehicles=config.vehicles, pedestrians=config.pedestrians),
        "own_traffic": FleetTraffic(**{name: getattr(config, name) for name in _HABITS}),
    }


def _rendered_on(device: torch.device) -> dict[str, Any]:
    """Return the vectorised environment's option that renders pictures on the device."""
    return {"backend": "cuda"} if device.type == "cuda" else {}


def _in_precision(encode: Callable[[Any], torch.Tensor], config: PPOConfig, device: torch.device) -> Any:
    def encoded(observation: Any) -> torch.Tensor:
        with torch.autocast(device.type, torch.bfloat16, enabled=config.bf16 and device.type == "cuda"):
            return encode(observation)

    return encoded
