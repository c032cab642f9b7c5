"""From waypoints to controls: the controllers of "Learning by Cheating" (CoRL 2019), for our car."""

from typing import Final

import torch
from torch import Tensor, nn

from wrongturn_agents.models.waypoints import APART, COUNT
from wrongturn_protocol import TrackerGains
from wrongturn_protocol.vehicle import DECISION_S, VEHICLE

MEMORY: Final = 2
"""Numbers that the controllers remember: the mean errors of steering and of speed. They begin with zeros."""


class WaypointControl(nn.Module):
    """Follows waypoints: a controller for the steering and one for the speed.

    It aims at the waypoint whose time is nearest to the gains'. :class:`wrongturn_client.Tracker` is the same without
    torch.
    """

    def __init__(self, gains: TrackerGains | None = None) -> None:
        super().__init__()
        self.gains = gains or TrackerGains()

    def forward(self, waypoints: Tensor, speed: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return steer, throttle and brake (B, 3), and the new memory (B, MEMORY).

        Waypoints (B, 5, 2) are forward and left of the body's centre, metres; the speed is (B, 1), m/s.
        """
        gains = self.gains
        aim = waypoints[:, round(gains.aim_s / APART) - 1]
        errors = torch.stack([steering_to(aim), mean_speed(waypoints) - speed[:, 0]], 1)
        means = memory + (errors - memory) * (DECISION_S / gains.lasting_s)
        steer = gains.steer[0] * errors[:, 0] + gains.steer[1] * means[:, 0]
        pull = gains.speed[0] * errors[:, 1] + gains.speed[1] * means[:, 1]
        pull = torch.where(mean_speed(waypoints) < gains.standing, torch.full_like(pull, -VEHICLE.braking), pull)
        action = [
            steer.clamp(-1.0, 1.0),
            (pull / VEHICLE.acceleration).clamp(0.0, 1.0),
            (-pull / VEHICLE.braking).clamp(0, 1),
        ]
        return torch.stack(action, 1), means


def mean_speed(waypoints: Tensor) -> Tensor:
    """Return the mean speed along waypoints (B, 5, 2) from the car's place on, (B,), m/s."""
    steps = torch.cat([waypoints[:, :1], waypoints[:, 1:] - waypoints[:, :-1]], 1)
    return steps.square().sum(2).sqrt().sum(1) / (COUNT * APART)


def steering_to(place: Tensor) -> Tensor:
    """Return the steering (B,) whose arc leads the rear axle through places (B, 2); negative to the left."""
    ahead, left = place[:, 0] + VEHICLE.wheelbase / 2.0, place[:, 1]
    curvature = 2.0 * left / (ahead.square() + left.square()).clamp_min(1.0)
    return -torch.atan(VEHICLE.wheelbase * curvature) / VEHICLE.max_wheel_angle
