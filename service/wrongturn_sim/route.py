"""The route planner: where the car should go, and the route's commands. It needs no SUMO.

The route leads through the trial's approach by the trial's exit. Each further exit is drawn from the trial's seed; a
journey takes the shortest way to its goal instead. After every exit the route is planned anew from the lane that the
car is in. A journey is also planned anew where the car enters such a lane late, or turned round in the junction.

The route names a direction while the body's centre is in the window: from 15 m before a stop line, or the distance that
the trial sets, to 5 m past the exit line. Elsewhere its command is LANE_FOLLOW.
"""

import math
import random
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town, exits_towards
from wrongturn_networks.faults.fault import Guidance
from wrongturn_protocol import Command, Trial
from wrongturn_protocol.observations import PATH_POINTS
from wrongturn_sim import guide
from wrongturn_sim.roads import Roads, roads_of

_COMMANDS: Final = {int(command): command for command in Command}


class Pose(NamedTuple):
    """Position and heading of the body's centre: metres, metres, radians."""

    x: float
    y: float
    yaw: float


def start_pose(town: Town, trial: Trial) -> Pose:
    """Return where a trial starts: on the approach's lane or, inside the junction, on the route's path.

    The trial's offset and heading are relative to that line.
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
    """Return the numbers that ``guide.update`` returned as a named tuple."""
    return Guidance(_COMMANDS[command], roads.approaches[leg] if leg >= 0 else None, travelled, lateral, heading)


@lru_cache(maxsize=512)
def way_to(town: Town, goal: str | None) -> NDArray[np.int8]:
    """Return the exit of each leg on the shortest way to a lane, (legs,); without a goal, all exits are drawn.

    An exit is also drawn where no way leads to the goal, so that a car that got there still has a route.

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


def start_route(
    roads: Roads, town: Town, trial: Trial, progress: NDArray[np.int64], places: NDArray[np.float64]
) -> NDArray[np.uint32]:
    """Set an ego's progress to a trial's start, and return the random draws of its route.

    Args:
        roads: the town's lanes and exits as arrays.
        town: town of the trial.
        trial: the trial that begins.
        progress: (PROGRESS_INTS,), changed.
        places: (PROGRESS_FLOATS,), changed.

    Returns:
        (DRAWS,) uint32.
    """
    leg = roads.legs[town.approach(trial.approach).lane]
    progress[:] = 0
    progress[guide.P_LEG] = leg
    progress[guide.P_GATE] = roads.gate_of(leg, trial.route)
    progress[guide.P_INSIDE] = trial.start.distance < 0.0
    progress[guide.P_AFTER] = -1
    progress[guide.P_JOURNEY] = trial.journey is not None
    places[:] = 0.0
    places[guide.P_WINDOW] = guide.WINDOW_BEFORE if trial.window is None else trial.window
    # A generator of its own: other draws do not shift the route.
    return guide.route_draws(random.Random(f"route {trial.seed}"))


class Navigator:
    """Follows the car along its route, one decision at a time."""

    __slots__ = ("_draws", "_places", "_progress", "_roads", "_tables", "_way")

    def __init__(self, town: Town, trial: Trial) -> None:
        self._roads = roads_of(town)
        self._tables = self._roads.tables
        self._progress = np.empty(guide.PROGRESS_INTS, np.int64)
        self._places = np.empty(guide.PROGRESS_FLOATS)
        self._draws = start_route(self._roads, town, trial, self._progress, self._places)
        self._way = way_to(town, trial.journey.goal if trial.journey is not None else None)

    def update(self, x: float, y: float) -> Guidance:
        """Return the guidance for the current place of the body's centre, metres."""
        found = guide.update(*self._tables, self._draws, self._way, self._progress, self._places, x, y)
        return guidance_of(self._roads, *found)

    @property
    def lane(self) -> str:
        """Id of the lane that the car is in; within a junction, of the lane that it came from."""
        return self._roads.names[int(self._progress[guide.P_LEG])]

    def lanes_ahead(self, metres: float) -> tuple[str, ...]:
        """Return the ids of the lanes along the route ahead; those after the first add up to ``metres`` or more."""
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
        """Metres along the lane to the stop line; -1 within a junction and where none lies within 60 m."""
        left: float = guide.stop_line(self._roads.ints, self._roads.floats, self._progress, self._places)
        return left

    def lane_ahead(self) -> NDArray[np.float32]:
        """Return the lane's centre line ahead as an observation shows it, (60, 2)."""
        out = np.empty((PATH_POINTS, 2), np.float32)
        guide.lane_ahead(*self._tables, self._progress, self._places, out)
        return out

    def exits(self) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """Return the junction's exits and their mask as an observation shows them, (3, 60, 2) and (3,)."""
        leg = int(self._progress[guide.P_LEG])
        shown, mask = self._roads.exits[leg], self._roads.exits_mask[leg]
        if self._progress[guide.P_INSIDE] or self.stop_line >= 0.0:
            return shown.copy(), mask.copy()
        return np.zeros_like(shown), np.zeros_like(mask)
