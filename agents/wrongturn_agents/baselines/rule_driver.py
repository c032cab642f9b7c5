"""Driving that all baselines share: pure pursuit along a path, at a safe speed, behind other road users.

A baseline adds its choice at a junction, :meth:`RuleDriver.choose`.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.baselines.path import Path
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Action, AgentKind, Command, Track
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.vehicle import VEHICLE

_PASSED: Final = 5.0  # metres past a stop line; further on, a visible stop line is the next junction's
_COMMITTED: Final = 45.0  # metres past a stop line within which the car keeps to its chosen path; it knows 60 of them
_CLEARANCE: Final = 0.4  # metres that must be free on either side of the body
_STAND: Final = 2.5  # metres between the bumpers when the car stands behind another
_SIGHT: Final = 50.0  # metres along the path; road users further away do not matter
_FORESIGHT: Final = (0.0, 0.7, 1.4)  # seconds ahead at which a road user may be in the way, at its present speed


@dataclass(frozen=True)
class Manner:
    """Speeds, accelerations and distances that a driver keeps to."""

    cruise: float = 10.0
    """Speed on an open street, m/s."""
    lateral: float = 3.0
    """Lateral acceleration in bends, m/s2; the tyres hold up to 7."""
    braking: float = 3.0
    """Deceleration for bends and stops, m/s2."""
    hard_braking: float = 6.0
    """Deceleration above which it is too late to stop before the line, m/s2."""
    look_ahead: tuple[float, float, float] = (3.0, 0.45, 8.0)
    """Distance of the point that the car steers for: minimum, seconds of travel, maximum; m, s, m."""
    gap: float = 1.0
    """Distance from the front bumper to the stop line when the car stands before it, metres."""
    gain: float = 4.0
    """Acceleration per unit of speed error, 1/s."""


class RuleDriver(ABC):
    """Agent that follows the lane, calls :meth:`choose` before each junction, and takes that exit or stops."""

    track: ClassVar[Track] = Track.PRIVILEGED
    kind: ClassVar[AgentKind] = AgentKind.BASELINE

    def __init__(self, manner: Manner | None = None) -> None:
        self.manner = manner or Manner()
        self._forget()

    @abstractmethod
    def choose(self, view: View) -> Command | None:
        """Return the direction to take at the junction ahead; None to stop before it.

        Called at every step until the car passes the stop line.
        """

    def path_beyond(self, view: View, direction: Command) -> NDArray[np.floating]:
        """Return (N, 2) points from the stop line in a chosen direction; by default those of the permitted exit."""
        return view.exits[direction]

    def reset(self, observation_space: spaces.Space[Any]) -> None:  # noqa: ARG002 - all baselines drive in one track
        """Forget the last episode."""
        self._forget()

    def act(self, observation: Observation) -> Action:
        """Return the action that follows the path as fast as it allows."""
        view = View.of(observation)
        path, stop = self._plan(view)
        here = path.project(view.x, view.y)
        acceleration = self._acceleration(view, path, here, stop)
        return Action(
            steer=min(max(self._steer(view, path), -1.0), 1.0),
            throttle=min(max(acceleration / VEHICLE.acceleration, 0.0), 1.0),
            brake=min(max(-acceleration / VEHICLE.braking, 0.0), 1.0),
        )

    def _forget(self) -> None:
        self._path: Path | None = None
        self._line: float | None = None
        self._choice: Command | None = None

    def _plan(self, view: View) -> tuple[Path, float | None]:
        """Return the path to follow, and the distance along it at which to stop; None to drive on."""
        if self._path is not None and self._line is not None:
            past = self._path.project(view.x, view.y) - self._line
            if past > _PASSED and view.near_junction:
                # Inside a junction no stop line is visible, so this one is the next junction's.
                self._forget()
            elif 0.0 < past < _COMMITTED:
                return self._path, None if self._choice is not None else self._line
        if not view.near_junction:
            self._forget()
            return _ahead(view, view.lane), None
        choice = self.choose(view)
        if choice is None and self._choice is not None and self._too_late_to_stop(view):
            choice = self._choice
        if self._path is None or self._line is None or choice is not self._choice:
            self._choice = choice
            beyond = view.lane[-1:] if choice is None else self.path_beyond(view, choice)
            self._path = _ahead(view, np.concatenate((view.lane, beyond)))
            self._line = self._path.project(*view.lane[-1].tolist())
        return self._path, None if choice is not None else self._line - VEHICLE.half_length - self.manner.gap

    def _too_late_to_stop(self, view: View) -> bool:
        return view.speed**2 > 2.0 * self.manner.hard_braking * max(0.0, view.stop_line - VEHICLE.half_length)

    def _steer(self, view: View, path: Path) -> float:
        """Return the steering by pure pursuit from the rear axle (Coulter, CMU-RI-TR-92-01)."""
        back = VEHICLE.wheelbase / 2.0
        rear_x, rear_y = view.x - back * math.cos(view.yaw), view.y - back * math.sin(view.yaw)
        least, seconds, greatest = self.manner.look_ahead
        reach = min(max(least, seconds * view.speed), greatest)
        goal_x, goal_y = path.at(path.project(rear_x, rear_y) + reach)
        aside = -math.sin(view.yaw) * (goal_x - rear_x) + math.cos(view.yaw) * (goal_y - rear_y)
        square = (goal_x - rear_x) ** 2 + (goal_y - rear_y) ** 2
        wheel = math.atan(2.0 * VEHICLE.wheelbase * aside / square)
        return -wheel / VEHICLE.max_wheel_angle  # CARLA's steering is negative to the left

    def _acceleration(self, view: View, path: Path, here: float, stop: float | None) -> float:
        """Return the acceleration to ask of the engine or the brakes, m/s2."""
        manner = self.manner
        speed = min(manner.cruise, path.speed_limit(here, manner.lateral, manner.braking))
        if stop is not None:
            speed = min(speed, math.sqrt(2.0 * manner.braking * max(0.0, stop - here)))
        if len(view.road_users):
            speed = min(speed, _speed_behind(path, here, view.road_users, manner.braking))
        if speed < 0.5:
            return -VEHICLE.braking
        return manner.gain * (speed - view.speed)


def _ahead(view: View, points: NDArray[np.floating]) -> Path:
    """Return the path through the points; if they are all the same, a straight path from the car."""
    if np.ptp(points, axis=0).max() < 0.1:
        heading = np.array((math.cos(view.yaw), math.sin(view.yaw)))
        points = np.stack((points[0] - heading, points[0]))
    return Path.through(points)


def _speed_behind(path: Path, here: float, road_users: NDArray[np.floating], braking: float) -> float:
    """Return the speed from which a car can stop behind the road users in its way, m/s; infinite if there are none.

    It is ``here`` metres along its path, and brakes by ``braking``, m/s2. The others are (N, 6): x, y, yaw, length,
    width, speed; metres, radians, m/s.
    """
    limit = math.inf
    for x, y, yaw, length, width, speed in road_users.tolist():
        for seconds in _FORESIGHT if speed > 0.1 else _FORESIGHT[:1]:
            there_x = x + seconds * speed * math.cos(yaw)
            there_y = y + seconds * speed * math.sin(yaw)
            along = path.project(there_x, there_y)
            if not 0.0 < along - here < _SIGHT:
                continue
            on_x, on_y = path.at(along)
            ahead_x, ahead_y = path.at(along + 0.5)
            turned = yaw - math.atan2(ahead_y - on_y, ahead_x - on_x)
            across = abs(length * math.sin(turned)) / 2 + abs(width * math.cos(turned)) / 2
            if math.hypot(there_x - on_x, there_y - on_y) > VEHICLE.half_width + across + _CLEARANCE:
                continue
            reach = abs(length * math.cos(turned)) / 2 + abs(width * math.sin(turned)) / 2
            gap = along - here - reach - VEHICLE.half_length - _STAND
            away = max(0.0, speed * math.cos(turned))
            limit = min(limit, math.sqrt(max(0.0, 2.0 * braking * gap + away * away)))
    return limit
