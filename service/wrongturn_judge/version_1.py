"""Version 1 of the verdict, kept to judge old records: its decision, compiled, and its judge.

It differs from ``decide.py`` in when a car stands (by its speed), when the time is up, and in its four flags.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from wrongturn_judge import decide, kernels
from wrongturn_judge.compiling import compiled_with
from wrongturn_judge.decide import (
    AHEAD,
    BEYOND,
    D_FLAGS,
    D_RAN_OUT,
    D_VERDICT,
    D_ZONE,
    INSIDE,
    KERB_BITE,
    LANE_INVASION,
    NEAR,
    NOT_ENGAGED,
    NOT_LATER,
    OVER_LINE,
    S_MIN_TTC,
    S_T,
    STANDING_FLOATS,
    STOPPED_BEFORE_JUNCTION,
    STOPPED_IN_JUNCTION,
    TIMEOUT,
    WRONG_WAY,
    WRONG_WAY_FLAG,
)
from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.junction_judge import JunctionJudge, outcome_fields
from wrongturn_judge.kernels import (
    FAR,
    I_LANE_TABLE,
    IN_OTHER,
    N_FRONT_AXLE,
    N_REAR_AXLE,
    N_TIME_LIMIT,
    N_WHEEL_SIDE,
    N_WHEELS_OFF,
    NOT_FINITE,
    NUMBERS,
    WHEELS,
    inspect_row,
    nose_past,
    project,
    surface,
)
from wrongturn_judge.packing import CLOCK_TOLERANCE, Floats, numbers_of
from wrongturn_judge.thresholds import THRESHOLDS_1, Thresholds1
from wrongturn_protocol import VEHICLE, Outcome, Trial, Vehicle

if TYPE_CHECKING:
    from wrongturn_judge.trajectory import Row

Array = np.ndarray[Any, Any]

N_STOP_SPEED, N_STOP_TIME = NUMBERS, NUMBERS + 1
"""Numbers of version 1, after the shared ones."""
S_SLOW_SINCE = STANDING_FLOATS
"""Float of the state: since when the car stands in its zone (nan: it moves)."""


@compiled_with(kernels)
def invades(
    floats: Array, ints: Array, cells: Array, numbers: Array, x: float, y: float, c: float, s: float
) -> bool:  # fmt: skip
    """Return whether a wheel is in a lane whose direction is opposed to the heading."""
    asked = 0  # the lane last compared with the heading: usually all four wheels are in the same lane
    for wheel in range(4):
        forward = numbers[N_FRONT_AXLE] if wheel < 2 else numbers[N_REAR_AXLE]
        left = numbers[N_WHEEL_SIDE] if wheel % 2 == 0 else -numbers[N_WHEEL_SIDE]
        wx = x + c * forward - s * left
        wy = y + s * forward + c * left
        _, _, lane = surface(floats, ints, cells, wx, wy)
        if lane not in {0, asked}:
            asked = lane
            table = ints[I_LANE_TABLE] + 4 * (lane - 1)
            _, _, ux, uy = project(floats, ints[table + 2], ints[table + 3], wx, wy)
            if c * ux + s * uy < 0.0:
                return True
    return False


@compiled_with(decide, kernels)
def decide_1(standing: Array, ints: Array, numbers: Array, route: int, bits: int) -> int:
    """Return the first verdict in version 1's order that holds at this row; 0 if none does."""
    verdict = decide.harm(numbers, bits)
    if verdict:
        return verdict
    t = standing[S_T]
    time_is_out = t >= numbers[N_TIME_LIMIT]
    stopped = t - standing[S_SLOW_SINCE] >= numbers[N_STOP_TIME]  # False for a car that moves: nan
    zone = ints[D_ZONE]
    if zone == INSIDE and (stopped or time_is_out):
        ints[D_RAN_OUT] = 0 if stopped else 1
        return STOPPED_IN_JUNCTION
    if zone == BEYOND:
        verdict = decide.exit_taken(ints, route, bits)
        if verdict:
            return verdict
        if bits & (FAR | IN_OTHER):
            return WRONG_WAY
    if stopped and zone == NEAR:
        return STOPPED_BEFORE_JUNCTION
    if stopped and zone == AHEAD:
        return NOT_ENGAGED
    if time_is_out:
        ints[D_RAN_OUT] = 1
        return NOT_ENGAGED if zone == AHEAD else TIMEOUT
    return 0


@compiled_with(decide, kernels)
def observe_1(
    floats: Array, whole: Array, cells: Array, numbers: Array, users: Array, standing: Array, ints: Array, route: int,
    t: float, x: float, y: float, yaw: float, v: float, command: int,
) -> int:  # fmt: skip
    """Take the next row, as :func:`~wrongturn_judge.decide.observe`, but without a history."""
    if not t > standing[S_T]:
        return NOT_LATER
    zone = ints[D_ZONE]
    bits, ttc = inspect_row(floats, whole, cells, numbers, users, x, y, yaw, v, zone >= INSIDE)
    if bits < 0:
        return NOT_FINITE
    decide.keep(standing, t, x, y, v)
    if ttc < standing[S_MIN_TTC]:  # noqa: PLR1730
        standing[S_MIN_TTC] = ttc
    zone = decide.zone_after(zone, bits)
    if v >= numbers[N_STOP_SPEED]:
        standing[S_SLOW_SINCE] = math.nan
    elif math.isnan(standing[S_SLOW_SINCE]) or zone != ints[D_ZONE]:
        standing[S_SLOW_SINCE] = t
    ints[D_ZONE] = zone
    decide.hear(ints, bits, command)
    c, s = math.cos(yaw), math.sin(yaw)
    if 1 <= (bits & WHEELS) < numbers[N_WHEELS_OFF]:
        ints[D_FLAGS] |= KERB_BITE
    if invades(floats, whole, cells, numbers, x, y, c, s):
        ints[D_FLAGS] |= LANE_INVASION
    verdict = decide_1(standing, ints, numbers, route, bits)
    if verdict == WRONG_WAY:
        ints[D_FLAGS] |= WRONG_WAY_FLAG
    if verdict == STOPPED_BEFORE_JUNCTION and nose_past(floats, numbers, x, y, c, s) > 0.0:
        ints[D_FLAGS] |= OVER_LINE
    ints[D_VERDICT] = verdict
    return verdict


def numbers_of_1(thresholds: Thresholds1, vehicle: Vehicle) -> Floats:
    """Return thresholds and body as the kernels of version 1 read them."""
    more = (thresholds.stop_speed, thresholds.stop_time - CLOCK_TOLERANCE)
    numbers: Floats = np.concatenate([numbers_of(thresholds, vehicle), more])
    numbers.setflags(write=False)
    return numbers


class Judge1(JunctionJudge):
    """Judges one recorded episode by version 1, row by row.

    Args:
        geometry: geometry of the trial's approach.
        trial: the trial that was driven.
        thresholds: those of version 1 by default.
        vehicle: the car's dimensions.

    Raises:
        GeometryMismatchError: the geometry's exits are not those of the trial's junction type, or the trial is a
            journey.
    """

    def __init__(
        self,
        geometry: JudgeGeometry,
        trial: Trial,
        thresholds: Thresholds1 = THRESHOLDS_1,
        vehicle: Vehicle = VEHICLE,
    ) -> None:
        super().__init__(geometry, trial, thresholds, numbers_of_1(thresholds, vehicle))
        self._standing = np.append(self._standing, math.nan)

    def _take(self, row: Row, users: Floats) -> int:
        return observe_1(
            self._floats, self._ints, self._cells, self._numbers, users, self._standing, self._counts, self._route,
            row.t, row.x, row.y, row.yaw, row.v, row.command,
        )  # fmt: skip

    def _conclude(self) -> Outcome:
        fields = outcome_fields(self._standing, self._counts, self.trial, self.geometry, self.thresholds)
        return Outcome(**fields)
