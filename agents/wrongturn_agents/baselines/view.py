"""Privileged observation with named fields."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import DIRECTIONS, Command
from wrongturn_protocol.observations import Observation

NO_STOP_LINE = -1.0
"""Value of ``stop_line`` if no stop line is ahead."""


@dataclass(frozen=True, eq=False)
class View:
    """Position, command and possible ways of the car."""

    x: float
    """Position of the body's centre in the town frame, metres."""
    y: float
    """Position of the body's centre in the town frame, metres."""
    yaw: float
    """Heading, counter-clockwise from east, radians."""
    speed: float
    """Speed, m/s."""
    command: Command
    """Command as delivered, right or wrong."""
    lane: NDArray[np.floating]
    """Centre line from the car to the stop line, (60, 2), filled up with its last point, metres."""
    stop_line: float
    """Distance from the body's centre to the stop line, metres; -1 if there is none within 60 m."""
    exits: dict[Command, NDArray[np.floating]]
    """Permitted paths from the stop line, (60, 2) each, metres, in the order LEFT, RIGHT, STRAIGHT."""
    road_users: NDArray[np.floating]
    """Road users in sight, (N, 6): x, y, yaw, length, width, speed; metres, radians, m/s."""

    @classmethod
    def of(cls, observation: Observation) -> "View":
        """Return the view of an observation of the privileged track."""
        x, y, yaw = observation["pose"].tolist()
        mask, paths = observation["exits_mask"], observation["exits"]
        return cls(
            x=x,
            y=y,
            yaw=yaw,
            speed=float(observation["speed"][0]),
            command=Command(int(observation["command"][0])),
            lane=observation["lane"],
            stop_line=float(observation["stop_line"][0]),
            exits={direction: paths[i] for i, direction in enumerate(DIRECTIONS) if mask[i]},
            road_users=observation["road_users"][: int(observation["road_users_count"][0])],
        )

    @property
    def near_junction(self) -> bool:
        """Whether a stop line is ahead and its exits are known."""
        return self.stop_line > NO_STOP_LINE and bool(self.exits)
