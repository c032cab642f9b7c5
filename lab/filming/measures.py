"""What a trajectory shows of the way into a junction."""

import math
from typing import Final, NamedTuple

from lab.failures import Measures
from wrongturn_networks import load_town
from wrongturn_protocol import Outcome
from wrongturn_sim import VEHICLE, JudgeGeometry, Row, Trajectory

TURNED: Final = 10.0
"""Degrees away from the lane at which a car has begun to turn. Starts are up to 6° askew."""
NEAR: Final = 10.0
"""Metres before the stop line from which a turn counts."""


class _Place(NamedTuple):
    """A row, beside the approach's lane extended straight."""

    past: float
    """How far the body's centre is past the stop line, m."""
    left: float
    """How far left of the lane's axis it is, m."""
    turned: float
    """Degrees between the lane and the car, positive to the left."""
    row: Row

    @property
    def inside(self) -> bool:
        """Whether the nose is past the stop line."""
        return self.past + VEHICLE.half_length >= 0.0


def measure(trajectory: Trajectory, outcome: Outcome) -> Measures:
    """Return what a trajectory shows."""
    geometry = JudgeGeometry.of(load_town(trajectory.trial.town), trajectory.trial)
    *_, ux, uy = geometry.stop_line
    heading = math.atan2(uy, ux)
    places = [
        _Place(*geometry.beside_approach(row.x, row.y), math.degrees(math.remainder(row.yaw - heading, math.tau)), row)
        for row in trajectory.rows
    ]
    inside = [place.row for place in places if place.inside]
    turn = next((place for place in places if place.past > -NEAR and abs(place.turned) >= TURNED), None)
    middle, _ = geometry.beside_approach(*geometry.middle)
    end = places[-1]
    wide = sum(map(_runs_wide, inside)) * (trajectory.rows[1].t - trajectory.rows[0].t) if inside else None
    return Measures(
        line_speed=_rounded(inside[0].v if inside else None),
        slowest=_rounded(min((row.v for row in inside), default=None)),
        steer_left=_rounded(max((max(-row.steering, 0.0) for row in inside), default=None)),
        steer_right=_rounded(max((max(row.steering, 0.0) for row in inside), default=None)),
        beyond_grip_s=_rounded(wide),
        turn_begins=_rounded(None if turn is None else turn.past),
        turned=round(end.turned, 2),
        past_middle=round(end.past - middle, 2),
        left=round(end.left, 2),
        end_speed=round(end.row.v, 2),
        end_brake=round(end.row.brake, 2),
        opposed_m=round(outcome.opposed_lane_m or 0.0, 2),
    )


def decision_before_line(trajectory: Trajectory, metres: float) -> int:
    """Return the number of the last decision at which the nose was this far before the stop line; 0 if none was."""
    geometry = JudgeGeometry.of(load_town(trajectory.trial.town), trajectory.trial)
    decision = 0
    for number, row in enumerate(trajectory.rows[::2]):
        past, _ = geometry.beside_approach(row.x, row.y)
        if past + VEHICLE.half_length > -metres:
            break
        decision = number
    return decision


def _runs_wide(row: Row) -> bool:
    """Return whether the wheels ask for a tighter curve than the grip allows."""
    curvature = math.tan(abs(row.steering) * VEHICLE.max_wheel_angle) / VEHICLE.wheelbase
    return curvature * row.v**2 > VEHICLE.grip


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
