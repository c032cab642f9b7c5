"""The route planner: where the car should go, and the route's commands. It needs no SUMO.

The route leads through the trial's approach by the trial's exit. Each further exit is drawn from the trial's seed; a
journey takes the shortest way to its goal instead. After every exit the route is planned anew from the lane that the
car is in. A journey is also planned anew where the car enters such a lane late, or turned round in the junction.

The route names a direction while the body's centre is in the window: from 15 m before a stop line, or the distance that
the trial sets, to 5 m past the exit line. Elsewhere its command is LANE_FOLLOW.
"""

import math
import random
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_faults.rules import OPENS, Guidance, Passage
from wrongturn_judge.compiling import words
from wrongturn_networks import Town, exits_towards
from wrongturn_networks.per_net import once_per_net
from wrongturn_protocol import DIRECTIONS, Command, Trial
from wrongturn_protocol.observations import PATH_POINTS
from wrongturn_sim import guide
from wrongturn_sim.polyline import Polyline
from wrongturn_sim.roads import Roads, roads_of

_COMMANDS: Final = {int(command): command for command in Command}
_new: Final = tuple.__new__


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


def guidance_of(roads: Roads, command: int, lateral: float, heading: float, told: tuple[Any, ...]) -> Guidance:
    """Return what ``guide.follow`` returned as a named tuple."""
    window, passed, last_route, last, past_line, past_exit, route, leg, to_line, to_exit = told
    exits = roads.directions
    # A tuple's own maker, as each argument that Python looks up takes longer than the compiled part.
    before = (
        _new(Passage, (_COMMANDS[last_route], exits[last], past_line, past_exit, passed == 1)) if last >= 0 else None
    )
    ahead = _new(Passage, (_COMMANDS[route], exits[leg], to_line, to_exit, passed == 0)) if leg >= 0 else None
    return _new(Guidance, (_COMMANDS[command], window, ahead, before, lateral, heading))


@once_per_net(512)
def way_to(town: Town, goal: str | None) -> NDArray[np.int8]:
    """Return the exit of each leg on the shortest way to a lane, (legs,); without a goal, all exits are drawn.

    An exit is also drawn where no way leads to the goal, so that a car that got there still has a route. Raises
    UnknownLaneError.
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


def start_route(roads: Roads, town: Town, trial: Trial, row: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Set a PROGRESS to a trial's start, and return the random draws of its route, (DRAWS,)."""
    leg = roads.legs[town.approach(trial.approach).lane]
    row[:] = 0.0
    progress = row.view(guide.PROGRESS)[0]
    progress.leg, progress.gate = leg, roads.gate_of(leg, trial.route)
    progress.inside = trial.start.distance < 0.0
    progress.last = -1
    progress.next = trial.next_route or 0
    progress.journey = trial.journey is not None
    progress.window = OPENS if trial.window is None else trial.window
    # A generator of its own: other draws do not shift the route.
    drawn = random.Random(f"route {trial.seed}").getrandbits(32 * guide.DRAWS)
    return np.frombuffer(drawn.to_bytes(4 * guide.DRAWS, "little"), "<u4").copy()


class Navigator:
    """Follows the car along its route, one decision at a time."""

    __slots__ = ("_closed", "_draws", "_progress", "_roads", "_row", "_way")

    def __init__(self, town: Town, trial: Trial) -> None:
        self._roads = roads_of(town)
        self._closed = town.closed
        self._row = np.empty(words(guide.PROGRESS))
        self._progress: Any = self._row.view(guide.PROGRESS)[0]
        self._draws = start_route(self._roads, town, trial, self._row)
        self._way = way_to(town, trial.journey.goal if trial.journey is not None else None)

    def update(self, x: float, y: float) -> Guidance:
        """Return the guidance for the current place of the body's centre, metres."""
        return guidance_of(self._roads, *guide.follow(*self._roads.tables, self._draws, self._way, self._row, x, y))

    @property
    def lane(self) -> str:
        """Id of the lane that the car is in; within a junction, of the lane that it came from."""
        return self._roads.names[int(self._progress.leg)]

    def line_and_place(self) -> tuple[Polyline, float]:
        """Return the lane's centre line, and metres along it; within the junction its length and the way from there."""
        line, s = self._roads.lanes[int(self._progress.leg)], float(self._progress.s)
        return line, line.length + s if self._progress.inside else s

    def lanes_ahead(self, metres: float) -> tuple[str, ...]:
        """Return the ids of the lanes along the route ahead; those after the first add up to ``metres`` or more."""
        legs = guide.legs_ahead(*self._roads.tables, self._draws, self._way, self._row.copy(), metres)
        return tuple(self._roads.names[leg] for leg in legs)

    @property
    def stop_line(self) -> float:
        """Metres along the lane to the stop line; -1 within a junction and where none lies within 60 m."""
        return guide.stop_line(self._roads.tables[2], self._row)

    def lane_ahead(self) -> NDArray[np.float32]:
        """Return the lane's centre line ahead as an observation shows it, (60, 2)."""
        out = np.empty((PATH_POINTS, 2), np.float32)
        guide.lane_ahead(*self._roads.tables[:3], self._row, out)
        return out

    def exits(self) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """Return the junction's exits and their mask as an observation shows them, (3, 60, 2) and (3,)."""
        leg = self._progress.leg
        shown, mask = self._roads.exits[leg], self._roads.exits_mask[leg]
        if not self._progress.inside and self.stop_line < 0.0:
            return np.zeros_like(shown), np.zeros_like(mask)
        shown, mask, approach = shown.copy(), mask.copy(), self._roads.approaches[leg]
        for leaving in approach.exits.values() if self._closed and approach is not None else ():
            if leaving.lane in self._closed:
                row = DIRECTIONS.index(leaving.direction)
                shown[row], mask[row] = 0.0, 0
        return shown, mask
