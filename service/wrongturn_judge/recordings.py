"""Recordings of other simulators: checked, resampled to the judge's rows, and judged by the rules of docs/judge.md."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import shapely

from wrongturn_judge.errors import RecordingError
from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.judges import Judge
from wrongturn_judge.packing import Floats
from wrongturn_judge.thresholds import THRESHOLDS
from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import Town, draw_trial, load_town, town_of
from wrongturn_networks.faults import WrongDirection, find_fault
from wrongturn_protocol import DIRECTIONS, VEHICLE, Command, Judgement, RecordedUser, Recording, Trial

_PER_SECOND: Final = 20
_CHORD_S: Final = 0.5  # over this time noise of places cancels out, and a car drives straight enough
_CLOSE: Final = 1e-4  # clocks that count from 1970 have digits of 2e-7 s
_NO_OTHERS: Final = "Collisions with other road users were not judged, as none are given; give others, or 'none'."


def judged(recording: Recording) -> tuple[Judgement, Trajectory]:
    """Return what the judge says of a recording, and the trajectory that it judged, up to the verdict.

    Raises RecordingError, UnknownTownError, UnknownApproachError.
    """
    motion = _checked(recording)
    trial, notes = _trial_of(recording, load_town(recording.town, recording.scenery), motion)
    town = town_of(trial)
    trajectory = Trajectory(trial, town.sha256, _rows(recording, motion, int(trial.route)))
    rear = recording.rear_axle or VEHICLE.rear_axle * (recording.length / VEHICLE.length)
    track = VEHICLE.half_track * (recording.width / VEHICLE.width)
    size = {"length": recording.length, "width": recording.width, "half_track": track}
    car = dataclasses.replace(VEHICLE, wheelbase=2 * rear, rear_axle=rear, **size)
    judge = Judge(JudgeGeometry.of(town, trial), trial, car=car)
    outcome = next(filter(None, map(judge.observe, trajectory.rows)), None)
    notes += [_NO_OTHERS] if recording.others is None else []
    if outcome is None:
        more = judge.seconds_more
        notes += [f"Undecided: {more:.2f} s more decide it, or fewer if the car leaves the road or stops."]
        return Judgement(seconds_more=more, notes=tuple(notes)), trajectory
    trajectory.rows[:] = [row for row in trajectory.rows if row.t <= outcome.time]
    columns = {"unsafe": outcome.verdict.unsafe, "unsafe_strict": outcome.unsafe_strict}
    severity = outcome.speed_at_verdict if outcome.unsafe_strict else None
    told = Judgement(verdict=outcome.verdict, **columns, severity_mps=severity, outcome=outcome, notes=tuple(notes))
    return told, trajectory


def _checked(recording: Recording) -> Floats:
    """Return t since the first row, x, y, yaw, v of the body's centre, (5, n). Raises RecordingError."""
    users = ((f"others.{number}.", user) for number, user in enumerate(recording.others or ()))
    for path, of in (("", recording), *users):
        for name in ("x", "y", "yaw", "speed", *(("commands",) if of is recording and recording.commands else ())):
            if len(getattr(of, name)) != len(recording.t):
                raise RecordingError(path + name, f"is not as long as t; give {len(recording.t)} values, one a row")
    if (recording.command is None) == (recording.commands is None):
        raise RecordingError("command", "give either command in the header or, if it changes, commands in each row")
    places = {"centre": 0.0, "rear_axle": recording.rear_axle, "front_bumper": -recording.length / 2}
    if (ahead := places[recording.reference]) is None:
        raise RecordingError("rear_axle", "missing; give metres from it to the centre, as it is the reference")
    t, (x, y, yaw, v) = np.array(recording.t) - recording.t[0], _in_town(recording, recording)
    x, y = x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)
    gaps, moved = np.diff(t), np.hypot(np.diff(x), np.diff(y))
    for bad, field, problem in (
        (gaps <= 0, "t", "is not after the row before; sort the rows, and drop repeated ones"),
        (gaps < 0.009, "t", "is less than 0.01 s after the row before; thin the rows to 100 a second"),
        (gaps > 0.201, "t", "is more than 0.2 s after the row before; give 5 rows a second or more, without gaps"),
        (moved > 1.5 * np.maximum(v[1:], v[:-1]) * gaps + 1, "x", "jumps, with y, as no car does; check units, or cut"),
        (abs(np.diff(yaw)) > 3 * gaps + 0.35, "yaw", "jumps as no car turns; check the unit of angles, or cut"),
    ):
        if bad.any():
            raise RecordingError(field, problem, int(bad.argmax()) + 1)
    ends = np.unique(np.searchsorted(t, np.arange(0, t[-1] + _CHORD_S, _CHORD_S)).clip(max=len(t) - 1))
    heads = (yaw[ends][1:] + yaw[ends][:-1]) / 2
    driven = float((np.diff(x[ends]) * np.cos(heads) + np.diff(y[ends]) * np.sin(heads)).sum())
    told = float((v[1:] + v[:-1]) @ gaps) / 2
    if abs(driven - told) > 2 + 0.25 * max(driven, told):
        problem = f"adds up to {told:.0f} m, but the car moves {driven:.0f} m where it heads; check units and frame"
        raise RecordingError("speed", problem)
    return np.stack([t, x, y, yaw, v])


def _in_town(recording: Recording, of: Recording | RecordedUser) -> Floats:
    """Return x, y, yaw, v in the town's frame, m and s, (4, n); nan where a road user is not there."""
    x, y, yaw, v = np.array([of.x, of.y, of.yaw, of.speed], np.float64)
    turn = -1.0 if recording.frame == "carla" else 1.0
    yaw *= turn * (math.pi / 180 if " deg " in recording.units else 1.0)
    yaw[np.isfinite(yaw)] = np.unwrap(yaw[np.isfinite(yaw)])
    return np.stack([x, y * turn, yaw, v / (3.6 if recording.units.endswith("km/h") else 1.0)])


def _trial_of(recording: Recording, town: Town, motion: Floats) -> tuple[Trial, list[str]]:
    """Return the trial that was driven, and what was assumed. Raises RecordingError, NetworkError."""
    approach, kind = town.approach(recording.approach), recording.fault
    _check_place(town, approach.id, motion)
    said = [Command[one] for one in dict.fromkeys(recording.commands or (recording.command,)) if one is not None]
    route = Command[recording.route] if recording.route else next((one for one in said if one in approach.exits), None)
    notes = [] if route else [f"The route was not given, and {next(iter(approach.exits)).name} was assumed."]
    route = route or next(iter(approach.exits))
    fault, wrong = find_fault(kind), next((one for one in said if one in DIRECTIONS and one is not route), None)
    # The seed decides which direction a fault names.
    for seed in range(16):
        drawn = draw_trial(town, approach.id, kind, seed, route=route)
        trial = drawn.model_copy(update={"town": recording.town, "watch": recording.watch})
        if wrong is None or fault is None or not issubclass(fault, WrongDirection) or fault.wrong(trial) is wrong:
            return trial, notes
    raise RecordingError("fault", f"{kind} cannot name {wrong and wrong.name} here; give the fault that it was")


def _check_place(town: Town, name: str, motion: Floats) -> None:
    """Raise RecordingError if a drive does not begin on an approach's lane."""
    lines = {one.id: shapely.LineString(town.lanes[one.lane].centreline) for one in town.approaches.values()}
    lane, points = town.lanes[town.approach(name).lane], shapely.points(motion[1], motion[2])
    along = shapely.line_locate_point(lines[name], points)
    on = (shapely.distance(lines[name], points) <= lane.width / 2 + 0.5) & (along < lane.length - 0.5)
    if on[0]:
        return
    if on.any():
        raise RecordingError("x", f"with y, first lies on the lane of {name}; cut the rows before", int(on.argmax()))
    off, near = town.road.distance(points[0]), min(lines, key=lambda one: lines[one].distance(points[0]))
    where = f"the car is never on its lane, and begins {off:.0f} m from the road, nearest to the lane of {near}"
    raise RecordingError("approach", f"{where}; check town, approach, frame and units")


def _rows(recording: Recording, motion: Floats, route: int) -> list[Row]:
    """Return the judge's rows, one each 0.05 s, linear between those of the recording."""
    times = motion[0]
    t = np.arange(math.floor(min(times[-1], THRESHOLDS.time_limit) * _PER_SECOND + _CLOSE) + 1) / _PER_SECOND
    x, y, yaw, v = (np.interp(t, times, column) for column in motion[1:])
    # The judge extends the last row by a second, with the steering that turned the car so.
    curvature = np.diff(yaw, prepend=yaw[0]) * _PER_SECOND / np.maximum(v, 0.1)
    steering = (-np.arctan(curvature * VEHICLE.wheelbase) / VEHICLE.max_wheel_angle).clip(-1, 1)
    at = recording.t[0] if recording.command_at is None else recording.command_at
    told = recording.commands or [str(recording.command) if one >= at else "LANE_FOLLOW" for one in recording.t]
    # A row has the command of the step that ends there.
    held = np.searchsorted(times, np.maximum(t - 1 / _PER_SECOND, 0) + _CLOSE, side="right") - 1
    users = [
        [(*place, user.length, user.width, speed) for *place, speed in np.stack(found, axis=1).tolist()]
        for user in recording.others or ()
        for found in [[np.interp(t, times, column) for column in _in_town(recording, user)]]
    ]
    rows = []
    for k, (*state, steered) in enumerate(np.stack([t, x, y, yaw, v, steering], axis=1).tolist()):
        said, there = Command[told[held[k]]], tuple(user[k] for user in users if all(map(math.isfinite, user[k])))
        leads = said if said is Command.LANE_FOLLOW else route
        rows.append(Row._make((*state, steered, int(said), int(leads), steered, 0.0, 0.0, there)))
    return rows
