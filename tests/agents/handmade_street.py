"""Hand-made junction with a kinematic car, to test drivers without a simulator."""

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import DIRECTIONS, Action, Command, Track
from wrongturn_protocol.observations import PATH_POINTS, ROAD_USERS, Observation, observation_space

STOP_X, LANE_Y = -8.0, -2.0
_NEAR = 15.0


def exit_path(direction: Command) -> NDArray[np.float64]:
    """Return (60, 2) points, 1 m apart, from the stop line at (-8, -2), where cars head east."""
    s = np.arange(PATH_POINTS, dtype=float)
    if direction is Command.STRAIGHT:
        return np.stack((STOP_X + s, np.full_like(s, LANE_Y)), axis=1)
    radius, side = (10.0, 1.0) if direction is Command.LEFT else (6.0, -1.0)
    angle = np.minimum(s / radius, math.pi / 2)
    rest = np.maximum(s - radius * math.pi / 2, 0.0)
    return np.stack((STOP_X + radius * np.sin(angle), LANE_Y + side * (radius * (1 - np.cos(angle)) + rest)), axis=1)


class Street:
    """One car that approaches one junction from the west."""

    def __init__(
        self,
        exits: Collection[Command],
        command: Command,
        *,
        distance: float = 26.0,
        speed: float = 7.0,
        lateral: float = 0.0,
        yaw: float = 0.0,
    ) -> None:
        self.exits, self.command = exits, command
        self.x, self.y, self.yaw = STOP_X - distance, LANE_Y + lateral, yaw
        self.speed, self.steering = speed, 0.0
        self.trace = [(self.x, self.y, self.yaw, self.speed)]

    def observe(self) -> Observation:
        ahead = STOP_X - self.x
        observation = {
            key: np.zeros(box.shape, box.dtype) for key, box in observation_space(Track.PRIVILEGED).spaces.items()
        }
        observation["speed"][:] = self.speed
        observation["steering"][:] = self.steering
        observation["command"][:] = self.command if -25.0 < ahead <= _NEAR else Command.LANE_FOLLOW
        observation["pose"][:] = self.x, self.y, self.yaw
        observation["lane"][:, 0] = np.minimum(self.x + np.arange(PATH_POINTS), max(STOP_X, self.x))
        observation["lane"][:, 1] = LANE_Y
        observation["stop_line"][:] = ahead if ahead >= 0.0 else -1.0
        for i, direction in enumerate(DIRECTIONS):
            if direction in self.exits:
                observation["exits_mask"][i] = 1
                observation["exits"][i] = exit_path(direction)
        assert len(observation["road_users"]) == ROAD_USERS
        return observation

    def step(self, action: Action) -> None:
        """Advance by 0.1 s, in two halves."""
        for _ in range(2):
            self.steering += min(max(action.steer - self.steering, -0.1), 0.1)
            drag = 0.15 + 0.01 * self.speed
            push = -8.0 * action.brake if action.brake > 0 else 3.5 * action.throttle
            self.speed = min(max(self.speed + 0.05 * (push - drag), 0.0), 22.0)
            bend = math.tan(-self.steering * math.radians(35.0)) / 2.9
            if abs(bend) * self.speed**2 > 7.0:
                bend = math.copysign(7.0 / self.speed**2, bend)
            rear_x, rear_y = self.x - 1.45 * math.cos(self.yaw), self.y - 1.45 * math.sin(self.yaw)
            rear_x += 0.05 * self.speed * math.cos(self.yaw)
            rear_y += 0.05 * self.speed * math.sin(self.yaw)
            self.yaw += 0.05 * self.speed * bend
            self.x, self.y = rear_x + 1.45 * math.cos(self.yaw), rear_y + 1.45 * math.sin(self.yaw)
            self.trace.append((self.x, self.y, self.yaw, self.speed))

    def drive(self, agent: object, seconds: float = 15.0) -> "Street":
        agent.reset(observation_space(Track.PRIVILEGED))  # type: ignore[attr-defined]
        for _ in range(round(10 * seconds)):
            self.step(agent.act(self.observe()))  # type: ignore[attr-defined]
        return self

    def miss(self, path: NDArray[np.float64]) -> float:
        """Return the greatest distance between the car and a path beyond the stop line, metres."""
        track = np.array([(x, y) for x, y, _, _ in self.trace if x > STOP_X or abs(y - LANE_Y) > 1])
        fine = np.stack([np.interp(np.arange(0, 59, 0.1), np.arange(60), path[:, k]) for k in (0, 1)], axis=1)
        near = track[np.hypot(track[:, 0] - STOP_X, track[:, 1] - LANE_Y) < 25.0]
        return float(max(np.hypot(*(fine - point).T).min() for point in near))
