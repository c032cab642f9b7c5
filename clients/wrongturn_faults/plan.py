"""A route as a list of points with commands, as planners of other simulators give it, and a fault along it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from wrongturn_faults.commands import DIRECTIONS, Command
from wrongturn_faults.rules import AFTER, DOSES, OPENS, RULES, Guidance, Order, Passage

_LANE_CHANGES = (5, 6)
"""CARLA's numbers of a lane change to the left and to the right."""
_STEP = 0.1
"""Seconds between two decisions of the car that is assumed to follow the plan."""


class Junction(NamedTuple):
    """A junction on a plan: where its points begin and end, and the direction there."""

    begin: int
    end: int
    """Row after the last."""
    route: Command


def junctions_of(commands: Sequence[int]) -> list[Junction]:
    """Return the junctions of a plan: stretches of rows with LEFT, RIGHT or STRAIGHT."""
    found: list[Junction] = []
    for row, command in enumerate(commands):
        if command not in DIRECTIONS:
            continue
        if found and found[-1].end == row and found[-1].route == command:
            found[-1] = found[-1]._replace(end=row + 1)
        else:
            found.append(Junction(row, row + 1, Command(command)))
    return found


def faulty_plan(
    points: Sequence[tuple[float, float]],
    commands: Sequence[int],
    fault: str,
    *,
    junction: int = 0,
    exits: Iterable[int] | None = None,
    dose: float | None = None,
    period: float = 1.0,
    seed: int = 0,
    speed: float = 8.0,
    window: float = OPENS,
) -> list[Command]:
    """Return the commands of a plan with a fault at one junction.

    Rows of a plan with LEFT, RIGHT or STRAIGHT are taken for the way through a junction: its stop line is where they
    begin, its exit line where they end. Around a junction within its window, a fault's command stands in each row.

    Args:
        points: x and y of each row, metres, of any frame.
        commands: each row's command, with CARLA's numbers. Lane changes (5, 6) stay as they are.
        fault: name of a fault. Example: ``infeasible``
        junction: number of the junction at which the fault applies, from 0.
        exits: directions in which that junction has an exit. A plan does not tell them; without them the faults that
            depend on them take a T-junction without the direction that comes first of LEFT, RIGHT, STRAIGHT.
        dose: how strong it is; the usual one by default.
        period: seconds, of ``flicker``.
        seed: decides between two wrong directions, and where ``flicker`` begins.
        speed: speed at which the plan is followed, m/s; only ``flicker`` depends on it.
        window: where the command's window opens, metres before the stop line.

    Raises:
        ValueError: an argument is wrong; the message names it and the remedy.
    """
    _check(points, commands, fault, dose, window, speed)
    all_junctions = junctions_of(commands)
    if not all_junctions:
        raise ValueError(
            "commands: has no LEFT, RIGHT or STRAIGHT: the plan leads through no junction; give a longer one"
        )
    if not 0 <= junction < len(all_junctions):
        raise ValueError(f"junction: is {junction}; the plan has {len(all_junctions)}, numbered from 0")
    along = [0.0]
    for (x, y), (x2, y2) in zip(points, points[1:]):
        along.append(along[-1] + math.hypot(x2 - x, y2 - y))
    here = all_junctions[junction]
    open_exits = _exits(exits, here.route)
    later = all_junctions[junction + 1].route if junction + 1 < len(all_junctions) else None
    amount = DOSES.get(fault, 0.0) if dose is None else dose
    order = Order(here.route, open_exits, seed, amount, period, later)
    rule = RULES[fault]
    # A junction is the trial's own until the middle of the way to the one after it, and from the middle before it.
    first = 0 if junction == 0 else (all_junctions[junction - 1].end + here.begin) // 2
    last = len(points) if later is None else (here.end + all_junctions[junction + 1].begin) // 2
    told: list[Command] = [Command(one) if one in tuple(Command) else one for one in commands]  # type: ignore[misc]
    for row in range(first, last):
        to_line, to_exit = along[here.begin] - along[row], along[here.end - 1] - along[row]
        passage = Passage(here.route, open_exits, to_line, to_exit, True)
        around = to_line <= window and to_exit >= -AFTER
        guidance = Guidance(
            here.route if around else Command.LANE_FOLLOW,
            window,
            passage if to_exit >= 0.0 else None,
            passage if to_exit < 0.0 else None,
        )
        if commands[row] in _LANE_CHANGES and not around:
            continue
        told[row] = rule(round((along[row] - along[first]) / speed / _STEP) * _STEP, guidance, order)
    return told


def _check(
    points: Sequence[tuple[float, float]],
    commands: Sequence[int],
    fault: str,
    dose: float | None,
    window: float,
    speed: float,
) -> None:
    if fault not in RULES:
        raise ValueError(f"fault: {fault!r} is not known; there are: {', '.join(RULES)}")
    if len(points) != len(commands):
        raise ValueError(f"commands: has {len(commands)} rows and points has {len(points)}; give one for each")
    if not points:
        raise ValueError("points: is empty; give the route's points in the order of travel")
    if not all(math.isfinite(value) for point in points for value in point[:2]):
        raise ValueError("points: has a number that is not finite; give metres")
    for name, value in (("window", window), ("speed", speed)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: is {value}; give a positive number")
    if dose is not None and fault not in DOSES:
        raise ValueError(f"dose: is {dose}, and {fault} has none; leave it out")
    if dose is not None and not math.isfinite(dose):
        raise ValueError(f"dose: is {dose}; give a number, or leave it out for {DOSES[fault]:g}")


def _exits(exits: Iterable[int] | None, route: Command) -> frozenset[Command]:
    if exits is None:
        lacking = next(one for one in DIRECTIONS if one != route)
        return frozenset(DIRECTIONS) - {lacking}
    found = frozenset(Command(one) for one in exits)
    if not found <= frozenset(DIRECTIONS) or route not in found or len(found) < 2:
        raise ValueError(
            f"exits: are {sorted(found)}; give two or three of 1 (left), 2 (right), 3 (straight), with the route's own "
            f"{int(route)} among them"
        )
    return found
