"""A trajectory as the episode's page shows it: a row for each decision, rounded, and its moments."""

import gzip
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import orjson
import shapely

from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import SceneryKind, Town, town_of
from wrongturn_networks.faults import closed_exit
from wrongturn_protocol import Command, Outcome
from wrongturn_service.web.words import COMMANDS, ended

ROWS: Final = 2
"""Rows of a decision. Its own constant, because the simulation's takes a compiler into memory."""
_STATE: Final = {"t": 2, "x": 2, "y": 2, "yaw": 3, "v": 2}
"""Columns of the car's state, and their decimals."""
_MOST: Final = 100
"""Moments that are listed."""


class Moment(NamedTuple):
    """Something that happened at a decision."""

    decision: int
    t: float
    """Seconds."""
    text: str
    """One or more sentences."""
    verdict: bool = False
    """Whether it is the moment of the verdict."""


def shown_rows(trajectory: Trajectory) -> list[Row]:
    """Return the row of each decision. The last one is the verdict's, which can come early."""
    rows = trajectory.rows
    return [*rows[:-1:ROWS], rows[-1]] if rows else []


def drive(trajectory: Trajectory) -> bytes:
    """Return what the page's scripts draw, as JSON that gzip has compressed.

    It has a list of numbers for each column, with one number a decision. ``command`` and ``route_command`` are those
    for the time after the decision, as the agent saw it; ``steer``, ``throttle`` and ``brake`` its reply to it.
    ``road_users`` has a list for each decision: x, y, yaw, length and width of one road user after the other.
    ``boards`` has both ends, x and y, of the boards that close a street.
    """
    rows, after = shown_rows(trajectory), _after(trajectory)
    columns: dict[str, list[object]] = {}
    for name, digits in _STATE.items():
        columns[name] = [round(getattr(row, name), digits) for row in rows]
    for name in ("steer", "throttle", "brake"):
        columns[name] = [round(getattr(row, name), 3) for row in after]
    columns["command"] = [row.command for row in after]
    columns["route_command"] = [row.route_command for row in after]
    if any(row.road_users for row in rows):
        columns["road_users"] = [[round(number, 2) for user in row.road_users for number in user[:5]] for row in rows]
    if closed_exit(trajectory.trial) is not None:
        boards = [thing for thing in town_of(trajectory.trial).scenery if thing.kind is SceneryKind.BOARD]
        columns["boards"] = [number for thing in (boards[0], boards[-1]) for number in (thing.x, thing.y)]
    return gzip.compress(orjson.dumps(columns), 5, mtime=0)


def _after(trajectory: Trajectory) -> list[Row]:
    """Return the row after each decision's, which has the command and the action of the decision."""
    rows = trajectory.rows
    return [*rows[1::ROWS], rows[-1]][: len(shown_rows(trajectory))]


def moments(trajectory: Trajectory, outcome: Outcome, town: Town) -> list[Moment]:
    """Return what happened during a drive, in the order of time; the last one is the verdict."""
    rows = shown_rows(trajectory)
    found = [*_commands(trajectory), *_junctions(rows, town), *_stands(rows, outcome)]
    found.sort(key=lambda moment: moment.decision)
    left_out = len(found) - _MOST
    if left_out > 0:
        last = found[_MOST - 1]
        found = [*found[:_MOST], Moment(last.decision, last.t, f"{left_out} more changes are not listed.")]
    verdict = Moment(len(rows) - 1, rows[-1].t, ended(outcome), verdict=True)
    return [Moment(0, 0.0, _start(trajectory)), *found, verdict]


def _start(trajectory: Trajectory) -> str:
    trial, row = trajectory.trial, trajectory.rows[0]
    where = f"{trial.start.distance:.0f} m before the stop line of {trial.approach}"
    return f"Starts at {row.v * 3.6:.0f} km/h, {where}. {_told(row.command, row.route_command)}"


def _told(command: int, route: int) -> str:
    said = COMMANDS[Command(command)]
    if command == route:
        return f"The command is “{said}”, as on the route."
    return f"The command is “{said}”, but the route says “{COMMANDS[Command(route)]}”."


def _commands(trajectory: Trajectory) -> Iterator[Moment]:
    before = None
    for decision, (row, after) in enumerate(zip(shown_rows(trajectory), _after(trajectory), strict=True)):
        told = after.command, after.route_command
        if before is not None and told != before:
            yield Moment(decision, row.t, _told(*told))
        before = told


def _junctions(rows: list[Row], town: Town) -> Iterator[Moment]:
    places = np.array([(row.x, row.y) for row in rows])
    for junction in town.junctions.values():
        inside = shapely.contains_xy(junction.area, places)
        for decision in np.flatnonzero(np.diff(inside)) + 1:
            said = f"Enters the junction {junction.id}." if inside[decision] else f"Leaves the junction {junction.id}."
            yield Moment(int(decision), rows[decision].t, said)


def _stands(rows: list[Row], outcome: Outcome) -> Iterator[Moment]:
    if outcome.first_stop_s is not None:
        decision = min(int(np.searchsorted([row.t for row in rows], outcome.first_stop_s)), len(rows) - 1)
        yield Moment(decision, rows[decision].t, "Begins to stand.")
