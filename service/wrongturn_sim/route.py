"""Where the car should go: the route planner and the commands of the route. It needs no SUMO.

The route leads through the trial's approach by the trial's exit and then onward, each further exit drawn from the
trial's seed, or to a journey's goal by the shortest way. It is planned anew after any exit, from the lane that the car
is in; a journey's also where the car comes into such a lane late, or turned round in the junction. The route's command
is named from 15 m before a stop line until 5 m past the exit line, by the body's centre; elsewhere it is LANE_FOLLOW.
"""

import math
import random
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town, exits_towards
from wrongturn_protocol import Command, Trial
from wrongturn_protocol.observations import PATH_POINTS
from wrongturn_sim import guide
from wrongturn_sim.faults.fault import Guidance
from wrongturn_sim.roads import Roads, roads_of

_COMMANDS: Final = {int(command): command for command in Command}


class Pose(NamedTuple):
    """Where the body's centre stands."""

    x: float
    y: float
    yaw: float


def start_pose(town: Town, trial: Trial) -> Pose:
    """Return where a trial begins: beside the line that it starts on, and turned as the trial says.

    The line is the approach's lane, or inside a junction the route's path.
    """
    roads = roads_of(town)
    leg = roads.legs[town.approach(trial.approach).lane]
    line = roads.lanes[leg]
    points, along = line.points, line.along
    s = max(0.0, line.length - trial.start.distance)
    if trial.start.distance < 0.0:
        points, along = roads.path_of(leg, roads.gate_of(leg, trial.route))
        s = -trial.start.distance
    i = min(max(int(np.searchsorted(along, s, side="right")) - 1, 0), len(along) - 2)
    (ax, ay), (bx, by) = points[i].tolist(), points[i + 1].tolist()
    ahead = s - float(along[i])
    heading = math.atan2(by - ay, bx - ax)
    cos, sin = math.cos(heading), math.sin(heading)
    yaw = heading + trial.start.yaw
    return Pose(
        ax + ahead * cos - trial.start.lateral * sin,
        ay + ahead * sin + trial.start.lateral * cos,
        math.atan2(math.sin(yaw), math.cos(yaw)),
    )


def guidance_of(roads: Roads, command: int, leg: int, travelled: float, lateral: float, heading: float) -> Guidance:
    """What ``guide.update`` returned, with the words' own names."""
    return Guidance(_COMMANDS[command], roads.approaches[leg] if leg >= 0 else None, travelled, lateral, heading)


@lru_cache(maxsize=512)
def way_to(town: Town, goal: str | None) -> NDArray[np.int8]:
    """(legs,): the exit of each leg on the shortest way to a lane; without a goal, all are drawn.

    Where no way leads there an exit is drawn, so that whoever came there is told where to go all the same.

    Raises:
        UnknownLaneError: the town has no such lane.
    """
    roads = roads_of(town)
    way = np.full(len(roads.lanes), guide.DRAWN, np.int8)
    if goal is not None:
        for lane, direction in exits_towards(town, goal).items():
            if direction is not None:
                leg = roads.legs[lane]
                way[leg] = roads.gate_of(leg, direction)
    way.setflags(write=False)
    return way


def start_route(roads: Roads, town: Town, trial: Trial, progress: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Put an ego's progress (``guide.PROGRESS_INTS``) to the begin of a trial; returns its route's draws."""
    leg = roads.legs[town.approach(trial.approach).lane]
    progress[:] = 0
    progress[guide.P_LEG] = leg
    progress[guide.P_GATE] = roads.gate_of(leg, trial.route)
    progress[guide.P_INSIDE] = trial.start.distance < 0.0
    progress[guide.P_AFTER] = -1
    progress[guide.P_JOURNEY] = trial.journey is not None
    return guide.route_draws(random.Random(f"route {trial.seed}"))  # of its own: no other draw shifts the route


class Navigator:
    """Follows the car along its route, decision by decision."""

    __slots__ = ("_draws", "_places", "_progress", "_roads", "_tables", "_way")

    def __init__(self, town: Town, trial: Trial) -> None:
        self._roads = roads_of(town)
        self._tables = self._roads.tables
        self._progress = np.empty(guide.PROGRESS_INTS, np.int64)
        self._places = np.zeros(guide.PROGRESS_FLOATS)
        self._draws = start_route(self._roads, town, trial, self._progress)
        self._way = way_to(town, trial.journey.goal if trial.journey is not None else None)

    def update(self, x: float, y: float) -> Guidance:
        """Take in where the body's centre is now."""
        found = guide.update(*self._tables, self._draws, self._way, self._progress, self._places, x, y)
        return guidance_of(self._roads, *found)

    @property
    def lane(self) -> str:
        """The id of the lane that the car is in, or came from into the junction."""
        return self._roads.names[int(self._progress[guide.P_LEG])]

    def lanes_ahead(self, metres: float) -> tuple[str, ...]:
        """The ids of the lanes that the route leads along from here, until so many metres lie behind the first."""
        ints, floats, progress = self._roads.ints, self._roads.floats, self._progress.copy()
        places = self._places.copy()
        lanes = [self.lane]
        while progress[guide.P_GATE] >= 0 and metres > 0.0:
            guide.leave(ints, floats, self._draws, self._way, progress, places, int(progress[guide.P_GATE]))
            leg = int(progress[guide.P_LEG])
            lanes.append(self._roads.names[leg])
            metres -= self._roads.lanes[leg].length
        return tuple(lanes)

    @property
    def stop_line(self) -> float:
        """Metres along the lane to the stop line ahead; -1 within the junction and where none lies within 60 m."""
        left: float = guide.stop_line(self._roads.ints, self._roads.floats, self._progress, self._places)
        return left

    def lane_ahead(self) -> NDArray[np.float32]:
        """(60, 2): the lane's centre line ahead, as an observation shows it."""
        out = np.empty((PATH_POINTS, 2), np.float32)
        guide.lane_ahead(*self._tables, self._progress, self._places, out)
        return out

    def exits(self) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """(3, 60, 2) and (3,): the junction's exits and which there are, as an observation shows them."""
        leg = int(self._progress[guide.P_LEG])
        shown, mask = self._roads.exits[leg], self._roads.exits_mask[leg]
        if self._progress[guide.P_INSIDE] or self.stop_line >= 0.0:
            return shown.copy(), mask.copy()
        return np.zeros_like(shown), np.zeros_like(mask)
