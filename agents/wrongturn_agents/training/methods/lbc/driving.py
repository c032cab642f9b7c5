"""Who drives the cars while samples are collected, and with which disturbance."""

from collections.abc import Mapping

import torch
from torch import Tensor

from wrongturn_agents.models.lbc import WaypointAgent, commanded
from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl
from wrongturn_agents.training.methods.lbc.config import LBCConfig

_LASTING = 0.9
"""Share of a disturbance that is left after a decision."""


class Drivers:
    """Controllers of all cars, and the disturbance of some.

    Args:
        config: share and strength of the disturbance.
        generator: of the disturbance, on the cars' device.
    """

    def __init__(self, count: int, config: LBCConfig, generator: torch.Generator) -> None:
        self._control = WaypointControl()
        self._config = config
        self._generator = generator
        device = generator.device
        self._memory = torch.zeros(count, MEMORY, device=device)
        self._noise = torch.zeros(count, device=device)
        self._noisy = torch.zeros(count, dtype=torch.bool, device=device)
        self.begin(torch.arange(count, device=device))

    def begin(self, cars: Tensor) -> None:
        """Forget the last drives of some cars, and draw which of them are disturbed."""
        self._memory[cars], self._noise[cars] = 0.0, 0.0
        chances = torch.rand(len(cars), generator=self._generator, device=cars.device)
        self._noisy[cars] = chances < self._config.noisy

    def act(self, waypoints: Tensor, speed: Tensor, disturbed: Tensor) -> Tensor:
        """Return steer, throttle and brake (n, 3).

        Args:
            waypoints: (n, 5, 2): where each car should drive.
            speed: (n, 1) m/s.
            disturbed: (n,) bool: cars that may be disturbed.
        """
        action, self._memory = self._control(waypoints, speed, self._memory)
        drawn = torch.randn(self._noise.shape, generator=self._generator, device=self._noise.device)
        self._noise = _LASTING * self._noise + self._config.noise * (1.0 - _LASTING**2) ** 0.5 * drawn
        action[:, 0] += torch.where(disturbed & self._noisy, self._noise, torch.zeros_like(self._noise))
        clamped: Tensor = action.clamp(-1.0, 1.0)
        return clamped


def told(agent: WaypointAgent, observation: Mapping[str, Tensor]) -> Tensor:
    """Return an agent's waypoints for the commands that are given, (n, 5, 2)."""
    return commanded(agent(observation), observation["command"]).float()
