"""A privileged observation as a driver reads it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import DIRECTIONS, Command
from wrongturn_protocol.observations import Observation

NO_STOP_LINE = -1.0
"""What ``stop_line`` says where no stop line lies ahead."""


@dataclass(frozen=True, eq=False)
class View:
    """Where the car is, what it is told, and where it could go."""

    x: float
    """Of the body's centre, town frame, metres."""
    y: float
    """Of the body's centre, town frame, metres."""
    yaw: float
    """Counter-clockwise from east, radians."""
    speed: float
    """Metres a second."""
    command: Command
    """As delivered, right or wrong."""
    lane: NDArray[np.floating]
    """(60, 2): the lane's centre line from the car to the stop line, then its last point again and again."""
    stop_line: float
    """Metres ahead of the body's centre; -1 where there is none within 60 m."""
    exits: dict[Command, NDArray[np.floating]]
    """The permitted paths from the stop line on, (60, 2) each, in the order LEFT, RIGHT, STRAIGHT."""
    road_users: NDArray[np.floating]
    """(N, 6): x, y, yaw, length, width, speed of the others in sight; metres, radians, metres a second."""

    @classmethod
    def of(cls, observation: Observation) -> "View":
        """Read an observation of the privileged track."""
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
        """Whether a stop line lies ahead and its exits are known."""
        return self.stop_line > NO_STOP_LINE and bool(self.exits)
