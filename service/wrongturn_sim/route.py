"""Where the car should go: the route planner and the commands of the route. It needs no SUMO.

The route leads through the trial's approach by the trial's exit and then onward, each further exit drawn from the
trial's seed. It is planned anew after any exit, from the lane that the car is in. The route's command is named from
15 m before a stop line until 5 m past the exit line, by the body's centre; elsewhere it is LANE_FOLLOW.
"""

import math
import random
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Approach, Lane, Town
from wrongturn_protocol import DIRECTIONS, Command, Trial
from wrongturn_protocol.observations import PATH_POINTS
from wrongturn_sim.polyline import Path, project

WINDOW_BEFORE: Final = 15.0
"""The command is named from so far before the stop line on, metres along the lane."""
WINDOW_AFTER: Final = 5.0
"""And until so far past the exit line."""
SIGHT: Final = 60.0
"""Stop lines and exits are shown within this distance, metres."""
_GATE_DEPTH: Final = 30.0
"""An exit was taken by a car that is in its lane within so far of the exit line, metres."""
_AT_END: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Gate:
    """One exit of a junction as the planner sees it."""

    direction: Command
    lane: str
    x: float
    y: float
    """Where its lane begins, metres."""
    ux: float
    uy: float
    """Along its lane there."""
    half_width: float
    """Of its lane, metres."""
    path: Path
    """From the stop line on, through the junction and along its lane."""

    def taken(self, x: float, y: float) -> bool:
        """Whether the point lies in the exit's lane, shortly past the exit line."""
        dx = x - self.x
        dy = y - self.y
        return 0.0 <= dx * self.ux + dy * self.uy <= _GATE_DEPTH and (
            -self.half_width <= self.ux * dy - self.uy * dx <= self.half_width
        )


@dataclass(frozen=True, eq=False)
class Leg:
    """A lane, and the junction at its end."""

    lane: Path
    approach: Approach | None
    """None where the lane leads into no junction."""
    gates: tuple[Gate, ...]
    exits: NDArray[np.float32]
    """(3, 60, 2): what an observation shows of the exits; zeros for those that are not there."""
    exits_mask: NDArray[np.int8]
    """(3,)"""

    def gate(self, direction: Command) -> Gate:
        """The exit of that direction; KeyError where there is none."""
        for gate in self.gates:
            if gate.direction is direction:
                return gate
        raise KeyError(direction)


def _gate(direction: Command, inner: Path, lane: Lane) -> Gate:
    outer = Path(lane.centreline)
    (x, y), (x2, y2) = outer.points[0], outer.points[1]
    ux, uy = float(x2 - x), float(y2 - y)
    length = math.sqrt(ux * ux + uy * uy)
    return Gate(
        direction,
        lane.id,
        float(x),
        float(y),
        ux / length,
        uy / length,
        lane.width / 2,
        inner.then(outer),
    )


@lru_cache(maxsize=1024)
def leg_of(town: Town, lane_id: str) -> Leg:
    """The leg that a lane of the town makes."""
    approach = town.approach_of_lane(lane_id)
    gates: tuple[Gate, ...] = ()
    if approach is not None:
        gates = tuple(
            _gate(exit_.direction, Path(exit_.path), town.lanes[exit_.lane]) for exit_ in approach.exits.values()
        )
    exits = np.zeros((len(DIRECTIONS), PATH_POINTS, 2), np.float32)
    mask = np.zeros(len(DIRECTIONS), np.int8)
    for gate in gates:
        row = DIRECTIONS.index(gate.direction)
        exits[row] = gate.path.sample(0.0, PATH_POINTS)
        mask[row] = 1
    return Leg(Path(town.lanes[lane_id].centreline), approach, gates, exits, mask)


class Pose(NamedTuple):
    """Where the body's centre stands."""

    x: float
    y: float
    yaw: float


def start_pose(town: Town, trial: Trial) -> Pose:
    """Where a trial begins: before the stop line, beside the lane's centre line and turned as the trial says."""
    lane = leg_of(town, town.approach(trial.approach).lane).lane
    s = max(0.0, lane.length - trial.start.distance)
    i = min(max(int(np.searchsorted(lane.along, s, side="right")) - 1, 0), len(lane.along) - 2)
    (ax, ay), (bx, by) = lane.points[i].tolist(), lane.points[i + 1].tolist()
    ahead = s - float(lane.along[i])
    heading = math.atan2(by - ay, bx - ax)
    cos, sin = math.cos(heading), math.sin(heading)
    yaw = heading + trial.start.yaw
    return Pose(
        ax + ahead * cos - trial.start.lateral * sin,
        ay + ahead * sin + trial.start.lateral * cos,
        math.atan2(math.sin(yaw), math.cos(yaw)),
    )


class Guidance(NamedTuple):
    """What the planner says at one decision; what faults work on."""

    command: Command
    """The route's: a direction within the window, LANE_FOLLOW elsewhere."""
    approach: Approach | None
    """Whose window this is; outside a window the approach ahead, if there is one."""
    travelled: float
    """Metres along the route from the begin of the nominal window; negative before it, inf with no junction ahead.
    Inside the junction it is measured along the route's path."""
    lateral: float
    """Of the body's centre beside the route's path, metres, positive to the left."""
    heading: float
    """Of the route's path there, radians."""


class Navigator:
    """Follows the car along its route, decision by decision."""

    __slots__ = ("_after", "_beyond", "_direction", "_inside", "_leg", "_random", "_s", "_town")

    def __init__(self, town: Town, trial: Trial) -> None:
        self._town = town
        self._random = random.Random(f"route {trial.seed}")  # of its own: no other draw shifts the route
        self._leg = leg_of(town, town.approach(trial.approach).lane)
        self._direction: Command | None = trial.route
        self._beyond: Path | None = self._leg.gate(trial.route).path
        self._inside = False
        self._s = 0.0
        # Whose window still holds past its exit line: approach, command, and metres travelled at the exit line.
        self._after: tuple[Approach, Command, float] | None = None

    def update(self, x: float, y: float) -> Guidance:
        """Take in where the body's centre is now."""
        leg = self._leg
        if self._inside:
            for gate in leg.gates:
                if gate.taken(x, y):
                    self._leave(gate)
                    leg = self._leg
                    break
            else:
                return self._within(leg, x, y)
        lane = leg.lane
        s, lateral, heading = project(lane.points, lane.along, x, y)
        self._s = s
        if self._after is not None:
            if s <= WINDOW_AFTER:
                approach, command, travelled = self._after
                return Guidance(command, approach, travelled + s, lateral, heading)
            self._after = None
        if self._direction is None:
            return Guidance(Command.LANE_FOLLOW, None, math.inf, lateral, heading)
        left = lane.length - s
        if left <= _AT_END:
            self._inside = True
            return self._within(leg, x, y)
        command = self._direction if left <= WINDOW_BEFORE else Command.LANE_FOLLOW
        return Guidance(command, leg.approach, WINDOW_BEFORE - left, lateral, heading)

    def _within(self, leg: Leg, x: float, y: float) -> Guidance:
        assert self._beyond is not None
        assert self._direction is not None
        s, lateral, heading = project(self._beyond.points, self._beyond.along, x, y)
        self._s = s
        return Guidance(self._direction, leg.approach, WINDOW_BEFORE + s, lateral, heading)

    def _leave(self, gate: Gate) -> None:
        """Plan anew from the lane of an exit that was taken, the route's or not."""
        assert self._leg.approach is not None
        assert self._direction is not None
        inner = gate.path.length - leg_of(self._town, gate.lane).lane.length
        self._after = (self._leg.approach, self._direction, WINDOW_BEFORE + inner)
        self._leg = leg_of(self._town, gate.lane)
        self._inside = False
        self._direction = self._beyond = None
        if self._leg.gates:
            onward = self._random.choice(self._leg.gates)
            self._direction, self._beyond = onward.direction, onward.path

    @property
    def stop_line(self) -> float:
        """Metres along the lane to the stop line ahead; -1 within the junction and where none lies within 60 m."""
        left = self._leg.lane.length - self._s
        return -1.0 if self._inside or self._leg.approach is None or left > SIGHT else left

    def lane_ahead(self) -> NDArray[np.float32]:
        """(60, 2): the lane's centre line ahead, as an observation shows it."""
        lane = self._leg.lane
        return lane.sample(lane.length if self._inside else self._s, PATH_POINTS)

    def exits(self) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """(3, 60, 2) and (3,): the junction's exits and which there are, as an observation shows them."""
        if self._inside or self.stop_line >= 0.0:
            return self._leg.exits.copy(), self._leg.exits_mask.copy()
        return np.zeros_like(self._leg.exits), np.zeros_like(self._leg.exits_mask)
