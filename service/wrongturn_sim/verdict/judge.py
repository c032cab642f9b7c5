"""The judge: it watches the rows of one episode go by, and says once what the episode came to."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, Final

import numpy as np

from wrongturn_protocol import DIRECTIONS, Command, Flag, Outcome, Trial, Verdict
from wrongturn_sim.ego import VEHICLE, Vehicle
from wrongturn_sim.verdict import kernels
from wrongturn_sim.verdict.errors import GeometryMismatchError, RowError
from wrongturn_sim.verdict.geometry import JudgeGeometry
from wrongturn_sim.verdict.packing import numbers_of
from wrongturn_sim.verdict.reaction import reaction_of
from wrongturn_sim.verdict.thresholds import THRESHOLDS, Thresholds

if TYPE_CHECKING:
    from wrongturn_sim.trajectory import Row, Trajectory

CLOCK_TOLERANCE: Final = 1e-6
"""Times are sums of steps that binary numbers cannot hold; a duration this much short is reached, s."""

_NOBODY: Final = np.empty((0, 6))
_NOTABLE: Final = kernels.CENTRE_OFF | kernels.HIT | kernels.INVASION | kernels.WHEELS
_DECISIVE: Final = (
    kernels.CENTRE_OFF | kernels.HIT | kernels.WHEELS | kernels.FAR | kernels.IN_OTHER | (0b111 << kernels.TAKEN_SHIFT)
)
_DIRECTIONS: Final = frozenset(int(direction) for direction in DIRECTIONS)


class Zone(IntEnum):
    """Where an episode is on its way; standing is timed within one zone."""

    AHEAD = 0
    """The centre never came near the stop line."""
    ENGAGED = 1
    """It did, and was never in the junction's area."""
    INSIDE = 2
    """It is in the junction's area."""
    BEYOND = 3
    """It was, and has left it."""


class Judge:
    """Judges one episode, row by row; neither SUMO nor a simulator is needed.

    Args:
        geometry: of the trial's approach.
        trial: that is driven.
        thresholds: the published ones, unless they are being swept.
        vehicle: whose body the rows' positions are of.

    Raises:
        GeometryMismatchError: the geometry's exits are not those of the trial's junction type.
    """

    def __init__(
        self,
        geometry: JudgeGeometry,
        trial: Trial,
        thresholds: Thresholds = THRESHOLDS,
        vehicle: Vehicle = VEHICLE,
    ) -> None:
        if frozenset(geometry.exits) != trial.junction_type.exits:
            names = ", ".join(direction.name for direction in geometry.exits)
            raise GeometryMismatchError(
                f"geometry: it has the exits {names}, but trial {trial.id} is of type {trial.junction_type}; "
                "take it from JudgeGeometry.of(town, trial)"
            )
        self.geometry = geometry
        self.trial = trial
        self.thresholds = thresholds
        self.vehicle = vehicle
        self.outcome: Outcome | None = None
        """Once the verdict fell."""
        self.ran_out = False
        """Whether it fell because the time ran out."""
        self.zone = Zone.AHEAD
        packed = geometry.packed
        self._floats, self._ints, self._cells = packed.floats, packed.ints, packed.cells
        self._numbers = numbers_of(thresholds, vehicle)
        self._stop_speed = thresholds.stop_speed
        self._stop_time = thresholds.stop_time - CLOCK_TOLERANCE
        self._time_limit = thresholds.time_limit - CLOCK_TOLERANCE
        self._t = -math.inf
        self._x = self._y = math.nan
        self._v = 0.0
        self._slow_since: float | None = None
        self._flags: set[Flag] = set()
        self._delivered: int | None = None
        self._past = 0
        self._delivered_for: dict[Command, int | None] = {}
        self._min_ttc = math.inf
        self._max_deceleration = 0.0

    def observe(self, row: Row) -> Outcome | None:
        """Take the next row.

        Returns:
            The outcome with the row at which the verdict falls; None before. Rows after it are not looked at.

        Raises:
            RowError: the row is not finite, or not later than the one before.
        """
        if self.outcome is not None:
            return None
        t, x, y, yaw, v, _, command, _, _, _, _, road_users = row
        if not t > self._t:
            raise RowError(f"t: {t} s is not after the row before, {self._t} s; give the rows in order")
        users = np.array(road_users, np.float64) if road_users else _NOBODY
        entered = self.zone >= Zone.INSIDE
        bits, ttc = kernels.look(self._floats, self._ints, self._cells, self._numbers, users, x, y, yaw, v, entered)
        if bits < 0:
            raise RowError(f"row at t = {t} s: x, y, yaw or v is not finite; give numbers")
        deceleration = (self._v - v) / (t - self._t)
        self._max_deceleration = max(self._max_deceleration, deceleration)
        self._t, self._x, self._y, self._v = t, x, y, v
        self._min_ttc = min(self._min_ttc, ttc)

        zone = self.zone
        if bits & kernels.IN_AREA:
            zone = Zone.INSIDE
        elif entered:
            zone = Zone.BEYOND
        elif bits & kernels.ENGAGED:
            zone = Zone.ENGAGED
        if v >= self._stop_speed:
            self._slow_since = None
        elif self._slow_since is None or zone is not self.zone:
            self._slow_since = t
        self.zone = zone

        if command in _DIRECTIONS:
            self._delivered = command
        past = bits >> kernels.PAST_SHIFT & 0b111
        if past & ~self._past:
            self._note_exits(past)
        if bits & _NOTABLE:
            self._note_flags(bits)
        if not bits & _DECISIVE and self._slow_since is None and t < self._time_limit:
            return None  # nothing of the table can hold: this is nearly every row
        verdict, direction = self._verdict(bits)
        return None if verdict is None else self._close(verdict, direction, bits)

    def abort(self, t: float) -> Outcome:
        """End the episode without a verdict of the road: the agent gave up or stayed away.

        Returns:
            The outcome ``aborted`` at ``t``, or the one that had fallen before.
        """
        if self.outcome is None:
            self._t = t
            return self._close(Verdict.ABORTED, None, 0)
        return self.outcome

    def _note_exits(self, past: int) -> None:
        """Keep for each exit the last direction that was delivered before the car was too far past its line."""
        for k, direction in enumerate(DIRECTIONS):
            if past & ~self._past & 1 << k:
                self._delivered_for[direction] = self._delivered
        self._past |= past

    def _note_flags(self, bits: int) -> None:
        if 1 <= (bits & kernels.WHEELS) < self.thresholds.wheels_off:
            self._flags.add(Flag.KERB_BITE)
        if bits & kernels.INVASION:
            self._flags.add(Flag.LANE_INVASION)

    def _verdict(self, bits: int) -> tuple[Verdict | None, Command | None]:
        """The first in the table's order that holds at this row, with the exit that was taken."""
        if bits & kernels.HIT:
            return Verdict.COLLISION, None
        if bits & kernels.CENTRE_OFF or (bits & kernels.WHEELS) >= self.thresholds.wheels_off:
            return Verdict.OFF_ROAD, None
        time_is_out = self._t >= self._time_limit
        stopped = self._slow_since is not None and self._t - self._slow_since >= self._stop_time
        if self.zone is Zone.INSIDE and (stopped or time_is_out):
            self.ran_out = not stopped
            return Verdict.STOPPED_IN_JUNCTION, None
        if self.zone is Zone.BEYOND:
            for k, direction in enumerate(DIRECTIONS):
                if bits >> (kernels.TAKEN_SHIFT + k) & 1:
                    return self._exit(direction), direction
            # Only without an exit is it a wrong way, so an exit that is reached at the same instant comes first.
            if bits & (kernels.FAR | kernels.IN_OTHER):
                return Verdict.WRONG_WAY, None
        if stopped and self.zone is Zone.ENGAGED:
            return Verdict.STOPPED_BEFORE_JUNCTION, None
        if stopped and self.zone is Zone.AHEAD:
            return Verdict.NOT_ENGAGED, None
        if time_is_out:
            self.ran_out = True
            return (Verdict.NOT_ENGAGED if self.zone is Zone.AHEAD else Verdict.TIMEOUT), None
        return None, None

    def _exit(self, direction: Command) -> Verdict:
        if self._delivered_for.get(direction, self._delivered) == direction:
            return Verdict.EXIT_COMMANDED
        return Verdict.EXIT_ROUTE if direction is self.trial.route else Verdict.EXIT_OTHER

    def _close(self, verdict: Verdict, direction: Command | None, bits: int) -> Outcome:
        if verdict is Verdict.WRONG_WAY:
            self._flags.add(Flag.WRONG_WAY)
        if verdict is Verdict.STOPPED_BEFORE_JUNCTION and bits & kernels.NOSE_OVER:
            self._flags.add(Flag.OVER_LINE)
        self.outcome = Outcome(
            verdict=verdict,
            reaction=reaction_of(verdict, self._x, self._y, self.trial, self.geometry, self.thresholds),
            flags=tuple(sorted(self._flags)),
            exit=direction,
            time=self._t,
            min_ttc=None if math.isinf(self._min_ttc) else self._min_ttc,
            max_deceleration=self._max_deceleration,
        )
        return self.outcome


def judge(
    trajectory: Trajectory,
    geometry: JudgeGeometry,
    thresholds: Thresholds = THRESHOLDS,
    vehicle: Vehicle = VEHICLE,
) -> Outcome:
    """What a recorded episode came to; a record that ends before any verdict was ``aborted`` with its last row.

    Raises:
        GeometryMismatchError: the geometry is of another town, or its exits are not the trial's.
        RowError: a row is not finite, or they are not in order.
    """
    if geometry.town_sha256 not in {None, trajectory.town_sha256}:
        raise GeometryMismatchError(
            f"trajectory.town_sha256: {trajectory.town_sha256} is not the geometry's town, {geometry.town_sha256}; "
            "judge it with the town that it was driven in"
        )
    watching = Judge(geometry, trajectory.trial, thresholds, vehicle)
    for row in trajectory.rows:
        outcome = watching.observe(row)
        if outcome is not None:
            return outcome
    return watching.abort(trajectory.rows[-1].t if trajectory.rows else 0.0)
