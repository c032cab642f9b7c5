"""A junction drawn by hand, and drives through it.

The car comes from the south on x = 2; the stop line is y = -8, the exit lines are 8 m from the middle. Lanes are 4 m
wide, arms 80 m long. A missing arm leaves a straight kerb 4 m from the middle.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from shapely import Point, affinity, box, unary_union
from shapely.geometry.base import BaseGeometry

from wrongturn_judge import THRESHOLDS, ExitLane, JudgeGeometry, LaneStrip, Thresholds, judge, judge_of
from wrongturn_judge.trajectory import RoadUser, Row, Trajectory
from wrongturn_protocol import DIRECTIONS, Command, Fault, FaultKind, JunctionType, Outcome, Start, Trial

LEFT, RIGHT, STRAIGHT, FOLLOW = Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW
STOP_LINE, HALF_LANE, ARM = 8.0, 2.0, 80.0
STEP = 0.05

_OUT = {LEFT: (-1.0, 0.0), STRAIGHT: (0.0, 1.0), RIGHT: (1.0, 0.0), None: (0.0, -1.0)}
"""Where each arm leads; None is the approach's own."""


def arm_lanes(arm: Command | None) -> tuple[LaneStrip, LaneStrip]:
    """The lane that leads away along an arm, and the one that comes in."""
    ox, oy = _OUT[arm]
    rx, ry = oy, -ox  # to the right of a car that drives out
    lanes = []
    for side in (1.0, -1.0):
        line = [
            (ox * s + rx * side * HALF_LANE, oy * s + ry * side * HALF_LANE)
            for s in ((STOP_LINE, ARM) if side > 0 else (ARM, STOP_LINE))
        ]
        xs = [ox * s + rx * side * w for s in (STOP_LINE, ARM) for w in (0.0, 4.0)]
        ys = [oy * s + ry * side * w for s in (STOP_LINE, ARM) for w in (0.0, 4.0)]
        lanes.append(LaneStrip(box(min(xs), min(ys), max(xs), max(ys)), np.array(line)))
    return lanes[0], lanes[1]


def junction_area(arms: Sequence[Command | None]) -> BaseGeometry:
    """The middle, a piece of each arm, and a rounded corner between neighbours."""
    pieces: list[BaseGeometry] = [box(-4, -4, 4, 4)]
    for arm in arms:
        ox, oy = _OUT[arm]
        xs, ys = (
            sorted((ox * 4 - abs(oy) * 4, ox * 8 + abs(oy) * 4)),
            sorted((oy * 4 - abs(ox) * 4, oy * 8 + abs(ox) * 4)),
        )
        pieces.append(box(xs[0], ys[0], xs[1], ys[1]))
    for one in arms:
        for two in arms:
            (ax, ay), (bx, by) = _OUT[one], _OUT[two]
            if ax * by - ay * bx == 1.0:
                cx, cy = 8 * (ax + bx), 8 * (ay + by)
                corner = box(min(cx, cx / 2), min(cy, cy / 2), max(cx, cx / 2), max(cy, cy / 2))
                pieces.append(corner.difference(Point(cx, cy).buffer(4.0)))
    return unary_union(pieces)


def junction(
    kind: JunctionType = JunctionType.CROSS,
    *,
    solids: Iterable[tuple[float, float, float, float, float]] = (),
    other_areas: Sequence[BaseGeometry] = (),
) -> JudgeGeometry:
    """A junction of a type, seen from its southern arm."""
    exits = [direction for direction in DIRECTIONS if direction in kind.exits]
    arms: list[Command | None] = [None, *exits]
    lanes = [lane for arm in arms for lane in arm_lanes(arm)]
    area = junction_area(arms)
    return JudgeGeometry(
        road=unary_union([area, *(lane.polygon for lane in lanes)]),
        area=area,
        approach=arm_lanes(None)[1].centreline,
        exits={direction: ExitLane(arm_lanes(direction)[0].centreline, 4.0) for direction in exits},
        middle=(0.0, 0.0),
        street_axis=2.0,
        lanes=tuple(lanes),
        other_areas=tuple(other_areas),
        solids=np.array(list(solids), np.float64).reshape(-1, 5),
    )


def trial(
    kind: JunctionType = JunctionType.CROSS, *, route: Command | None = None, fault: FaultKind = FaultKind.NONE
) -> Trial:
    """A trial of that junction."""
    route = route or next(direction for direction in DIRECTIONS if direction in kind.exits)
    return Trial(
        id=f"handmade.X-S.{fault}.s0",
        town="handmade",
        approach="X-S",
        junction_type=kind,
        route=route,
        start=Start(distance=25.0, speed=8.0, lateral=0.0, yaw=0.0),
        fault=Fault(kind=fault),
        seed=0,
    )


Points = list[tuple[float, float]]
Legs = Sequence[tuple[float, float]]
"""Seconds and metres per second, one after the other."""


def arc(x: float, y: float, heading: float, radius: float, angle: float) -> Points:
    """Points of a turn that begins at x, y; a positive angle turns left."""
    sign = math.copysign(1.0, angle)
    cx, cy = x - sign * radius * math.sin(heading), y + sign * radius * math.cos(heading)
    count = max(int(radius * abs(angle) / 0.1), 8)
    return [
        (
            cx + sign * radius * math.sin(heading + angle * k / count),
            cy - sign * radius * math.cos(heading + angle * k / count),
        )
        for k in range(count + 1)
    ]


def way(direction: Command, *, lateral: float = 0.0, begin: float = 25.0, out: float = 60.0) -> Points:
    """From ``begin`` metres before the stop line by an exit, ``lateral`` metres left of the lanes' centre lines."""
    x = 2.0 - lateral
    start = [(x, -STOP_LINE - begin)]
    if direction is STRAIGHT:
        return [*start, (x, STOP_LINE + out)]
    if direction is LEFT:
        return [
            *start,
            *arc(x, -STOP_LINE, math.pi / 2, 10.0 - lateral, math.pi / 2),
            (-STOP_LINE - out, 2.0 - lateral),
        ]
    return [*start, *arc(x, -STOP_LINE, math.pi / 2, 6.0 + lateral, -math.pi / 2), (STOP_LINE + out, -2.0 + lateral)]


def drive(
    points: Points,
    legs: Legs,
    *,
    command: int | Callable[[float], int] = FOLLOW,
    users: Callable[[float], tuple[RoadUser, ...]] = lambda t: (),
    yaw: Callable[[float], float] = lambda s: 0.0,
    step: float = STEP,
) -> list[Row]:
    """Rows along a path: command and further yaw may depend on the distance driven, road users on the time."""
    xs, ys = np.array(points).T
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(xs), np.diff(ys)))])
    per_second = round(1 / step)
    rows, s = [], 0.0
    speeds = [speed for seconds, speed in legs for _ in range(round(seconds * per_second))]
    for k, v in enumerate(speeds):
        i = min(int(np.searchsorted(along, s, "right")) - 1, len(along) - 2)
        share = (s - along[i]) / (along[i + 1] - along[i])
        x, y = (float(c[i] + (c[i + 1] - c[i]) * share) for c in (xs, ys))
        heading = math.atan2(ys[i + 1] - ys[i], xs[i + 1] - xs[i]) + yaw(s)
        told = command if isinstance(command, int) else command(s)
        t = k / per_second
        rows.append(Row(t, x, y, heading, float(v), 0.0, int(told), int(FOLLOW), 0.0, 0.0, 0.0, users(t)))
        s += v * step
    return rows


def verdict_of(
    rows: Sequence[Row], geometry: JudgeGeometry, its_trial: Trial, thresholds: Thresholds = THRESHOLDS
) -> Outcome:
    """The outcome, judged from the record and row by row, which must agree."""
    recorded = judge(Trajectory(its_trial, geometry.town_sha256 or "0" * 64, list(rows)), geometry, thresholds)
    online = judge_of(geometry, its_trial, thresholds)
    outcomes = [outcome for row in rows if (outcome := online.observe(row))]
    assert len(outcomes) <= 1
    assert recorded == (outcomes[0] if outcomes else online.abort(rows[-1].t))
    return recorded


MIRRORED = {LEFT: RIGHT, RIGHT: LEFT, STRAIGHT: STRAIGHT}
"""Each direction in a mirror."""


def _flipped(shape: BaseGeometry) -> BaseGeometry:
    return affinity.scale(shape, 1.0, -1.0, origin=(0.0, 0.0))


def mirrored(one: JudgeGeometry) -> JudgeGeometry:
    """The geometry mirrored at the x axis: y becomes -y, left becomes right."""
    flip = np.array([1.0, -1.0])
    exits = {MIRRORED[direction]: ExitLane(lane.centreline * flip, lane.width) for direction, lane in one.exits.items()}
    return dataclasses.replace(
        one,
        road=_flipped(one.road),
        area=_flipped(one.area),
        approach=one.approach * flip,
        exits=exits,
        middle=(one.middle[0], -one.middle[1]),
        street_axis=-one.street_axis,
        lanes=tuple(LaneStrip(_flipped(lane.polygon), lane.centreline * flip) for lane in one.lanes),
        other_areas=tuple(_flipped(area) for area in one.other_areas),
        solids=one.solids * np.array([1.0, -1.0, -1.0, 1.0, 1.0]),
        town_sha256=None,
    )


def mirrored_rows(rows: Sequence[Row]) -> list[Row]:
    """The same drive in a mirror along the x axis."""
    swap = {int(LEFT): int(RIGHT), int(RIGHT): int(LEFT)}
    return [
        row._replace(
            y=-row.y,
            yaw=-row.yaw,
            steering=-row.steering,
            command=swap.get(row.command, row.command),
            route_command=swap.get(row.route_command, row.route_command),
            steer=-row.steer,
            road_users=tuple((x, -y, -yaw, length, width, v) for x, y, yaw, length, width, v in row.road_users),
        )
        for row in rows
    ]


def mirrored_trial(one: Trial) -> Trial:
    """The same trial in that mirror."""
    return one.model_copy(
        update={
            "route": MIRRORED[one.route],
            "junction_type": JunctionType.of(frozenset(MIRRORED[exit_] for exit_ in one.junction_type.exits)),
        }
    )
