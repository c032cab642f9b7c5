"""Controls for models that answer with a trajectory: the controllers of "Learning by Cheating" (CoRL 2019)."""

import math
from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np

from wrongturn_protocol.episodes import Action
from wrongturn_protocol.rigs import TrackerGains
from wrongturn_protocol.vehicle import DECISION_S, VEHICLE

FAR: Final = 1e6
"""Metres that no waypoint reaches: sums of squares stay finite."""


class Tracker:
    """Follows a model's trajectories, one after the other. Make a new one for each episode: it remembers mean errors.

    Args:
        times: seconds from now at which the car is to be at each waypoint, growing. Example: ``[0.5, 1.0, 1.5, 2.0]``.
        side: to which side the second coordinate grows: ``left`` as in NAVSIM, ``right`` as in CARLA.
        behind: how far the waypoints' origin lies behind the body's centre, metres; of the rear axle 1.45.
        gains: settings of the controllers.
        decision_s: seconds from one decision to the next.

    Raises:
        ValueError: an argument is wrong. The message names it.
    """

    def __init__(
        self,
        times: Sequence[float],
        *,
        side: Literal["left", "right"] = "left",
        behind: float = 0.0,
        gains: TrackerGains | None = None,
        decision_s: float = DECISION_S,
    ) -> None:
        self._times = np.array([0.0, *times], float)
        if len(times) == 0 or not np.all(np.diff(self._times) > 0.0):  # also if one is nan
            raise ValueError(f"times: are {list(times)}; give growing seconds above 0, one for each waypoint")
        if side not in {"left", "right"}:
            raise ValueError(f"side: is {side!r}; give 'left' or 'right'")
        self._side, self._behind, self._gains = 1.0 if side == "left" else -1.0, behind, gains or TrackerGains()
        self._means, self._decision_s = np.zeros(2), decision_s

    def controls(self, waypoints: Any, speed: float) -> Action:
        """Return steer, throttle and brake until the next decision.

        Args:
            waypoints: (n, 2), metres: forward and to the ``side``, one for each of the times, in the car's frame.
            speed: the car's speed, m/s: the observation's ``speed[0]``.

        Raises:
            ValueError: the waypoints have another shape, or are not finite.
        """
        wanted = (len(self._times) - 1, 2)
        try:
            given = np.asarray(waypoints, float)
        except (ArithmeticError, TypeError, ValueError) as error:
            raise ValueError(f"waypoints: are no numbers ({error}); give {wanted}, metres") from error
        if given.shape != wanted:
            raise ValueError(f"waypoints: have the shape {given.shape}; give {wanted}, one for each of the times")
        if not (np.abs(given) < FAR).all():
            raise ValueError(f"waypoints: are not finite, or farther than {FAR:.0f} m; give metres from the car")
        path = np.vstack([np.zeros(2), given * (1.0, self._side)]) - (self._behind, 0.0)
        gains = self._gains
        desired = float(np.hypot(*np.diff(path, axis=0).T).sum() / self._times[-1])
        aim = [np.interp(gains.aim_s, self._times, path[:, axis]) for axis in (0, 1)]
        errors = np.array([steering_to(*aim), desired - speed])
        self._means += (errors - self._means) * (self._decision_s / gains.lasting_s)
        steer = gains.steer[0] * errors[0] + gains.steer[1] * self._means[0]
        pull = gains.speed[0] * errors[1] + gains.speed[1] * self._means[1]
        if desired < gains.standing:
            pull = -VEHICLE.braking
        throttle, brake = pull / VEHICLE.acceleration, -pull / VEHICLE.braking
        return Action(*(float(np.clip(one, low, 1.0)) for one, low in ((steer, -1.0), (throttle, 0.0), (brake, 0.0))))


def steering_to(ahead: float, left: float) -> float:
    """Return the steering whose arc leads the rear axle through a place, metres from the body's centre; left is < 0."""
    from_axle = ahead + VEHICLE.rear_axle
    curvature = 2.0 * left / max(from_axle**2 + left**2, 1.0)
    return -math.atan(VEHICLE.wheelbase * curvature) / VEHICLE.max_wheel_angle
