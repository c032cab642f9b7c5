"""A town from above, and what happens in an episode, drawn over it."""

import math
from collections.abc import Iterable
from typing import Final

import cv2
import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wrongturn_judge.trajectory import RoadUser, Row
from wrongturn_networks import Town
from wrongturn_networks.scenery import SceneryKind, SceneryObject
from wrongturn_protocol import VEHICLE, Command, Outcome, Safety, Trial
from wrongturn_protocol.words import COMMANDS, name
from wrongturn_sim.ego import SUB_STEP
from wrongturn_sim.view import colours
from wrongturn_sim.view.colours import Colour
from wrongturn_sim.view.window import Image, Points, Window, box, turned, width_of, write

LEAST: Final = 40.0
"""Side of the smallest window, metres."""
MOST: Final = 150.0
"""Side of the largest window that stands still, metres. On a longer way the window follows the car."""
FOLLOWING: Final = 90.0
"""Side of a window that follows the car, metres."""
FASTEST: Final = 10.0
"""Speed at the end of the colours' scale if the car was not faster, m/s."""
_MARGIN: Final = 12.0
_FOOTPRINT: Final = 1.0
"""Least seconds between two footprints."""
_FOOTPRINTS: Final = 60
"""Number of footprints of a long way, about."""
_PEDESTRIAN: Final = 0.5
"""Length of a pedestrian, metres."""

_PLANTS: Final = {SceneryKind.TREE, SceneryKind.HEDGE}
_STOP_LINE: Final = 0.4
"""Width of a stop line, metres."""


def name_of(command: int) -> str:
    """Return a command as people say it."""
    return COMMANDS[Command(command)]


def safety_of(outcome: Outcome) -> Safety:
    """Return what an outcome's verdict counts as, in the strict column."""
    return Safety.UNSAFE if outcome.verdict.unsafe_strict else outcome.verdict.safety


def verdict_of(outcome: Outcome) -> tuple[str, Colour]:
    """Return a verdict as people say it, and its colour."""
    return name(outcome.verdict), colours.OF_SAFETY[safety_of(outcome)]


def fastest_of(rows: list[Row]) -> float:
    """Return the speed at the end of the colours' scale, m/s."""
    return max(FASTEST, float(math.ceil(max(row.v for row in rows))))


def up_of(town: Town, trial: Trial) -> float:
    """Return the direction that points up in pictures of a trial, radians: the approach's; of a journey, north."""
    return math.pi / 2 if trial.journey is not None else town.approach(trial.approach).heading


def whole_window(town: Town, rows: list[Row], approach: str | None, size: int, up: float = math.pi / 2) -> Window:
    """Return a window, ``size`` pixels wide, with the whole way and, if that is short, with the approach's junction.

    The direction ``up``, radians, points up.
    """
    places = turned(np.array([(row.x, row.y) for row in rows]), up)
    low, high = places.min(axis=0), places.max(axis=0)
    if approach is not None and (high - low).max() <= MOST:
        hull = town.junctions[town.approach(approach).junction].area.convex_hull
        area = turned(np.array(hull.exterior.coords), up)
        low, high = np.minimum(low, area.min(axis=0)), np.maximum(high, area.max(axis=0))
    x, y = turned((low + high) / 2, math.pi - up).tolist()  # back into the town's frame
    return Window(x, y, max(LEAST, float((high - low).max()) + 2 * _MARGIN), size, up)


def draw_ground(town: Town, window: Window) -> Image:
    """Return the town's part that a window shows, without any road user."""
    image = np.full((window.size, window.size, 3), colours.GROUND, np.uint8)
    half = window.extent / math.sqrt(2) + 1.0  # whichever direction points up
    shown = shapely.box(window.x - half, window.y - half, window.x + half, window.y + half)
    _area(image, window, town.sidewalks.intersection(shown), colours.SIDEWALK)
    _scenery(image, window, [thing for thing in town.scenery if thing.kind is not SceneryKind.BOARD])
    _area(image, window, town.road.intersection(shown), colours.ROAD)
    for junction in town.junctions.values():
        if junction.area.intersects(shown):
            _area(image, window, junction.area, colours.JUNCTION)
    for ring in _rings(town.road.intersection(shown)):
        window.line(image, ring, colours.EDGE, 1, closed=True)
    for approach in town.approaches.values():
        across = (
            np.array([-math.sin(approach.heading), math.cos(approach.heading)]) * town.lanes[approach.lane].width / 2
        )
        ends = np.array(approach.stop_line) + np.stack([across, -across])
        window.line(image, ends, colours.STOP_LINE, _STOP_LINE * window.scale)
    for thing in town.scenery if town.closed else ():
        if thing.kind is SceneryKind.BOARD:
            corners = np.array(thing.footprint().exterior.coords)
            window.line(image, corners, colours.BOARD, max(2.0, 0.3 * window.scale), closed=True)
    return image


def _area(image: Image, window: Window, area: BaseGeometry, colour: Colour) -> None:
    rings = _rings(area)
    if rings:
        window.fill(image, rings, colour)


def _rings(area: BaseGeometry) -> list[Points]:
    """Return the outlines and the holes of an area's polygons."""
    polygons = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and not part.is_empty]
    return [np.array(ring.coords) for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]


def _scenery(image: Image, window: Window, scenery: Iterable[SceneryObject]) -> None:
    for thing in scenery:
        reach = thing.length + thing.width + window.extent / math.sqrt(2)
        if max(abs(thing.x - window.x), abs(thing.y - window.y)) > reach:
            continue
        colour = colours.PLANT if thing.kind in _PLANTS else colours.BUILDING
        footprint = thing.footprint()
        if thing.crown_radius:
            footprint = footprint.centroid.buffer(thing.crown_radius)
        window.fill(image, [np.array(footprint.exterior.coords)], colour)


def draw_trail(image: Image, window: Window, rows: list[Row], fastest: float) -> None:
    """Draw the way of the car's middle, coloured by its speed."""
    places = np.array([(row.x, row.y) for row in rows])
    for k in range(len(rows) - 1):
        window.line(image, places[k : k + 2], colours.of_speed(rows[k + 1].v, fastest), max(2.0, 0.35 * window.scale))


def draw_footprints(image: Image, window: Window, rows: list[Row], fastest: float) -> None:
    """Draw where the car's body was from time to time, coloured by its speed."""
    for row in rows[:: max(round(_FOOTPRINT / SUB_STEP), len(rows) // _FOOTPRINTS)]:
        corners = _body(row)
        light = image.copy()
        window.fill(light, [corners], colours.of_speed(row.v, fastest))
        cv2.addWeighted(image, 0.65, light, 0.35, 0.0, dst=image)
        window.line(image, corners, colours.of_speed(row.v, fastest), max(1.0, 0.12 * window.scale), closed=True)


def draw_commands(image: Image, window: Window, rows: list[Row]) -> None:
    """Write each delivered command beside the place where it began; the route's too, if it was another one."""
    before = None
    letter = window.size / 60
    for row in rows:
        told = (row.command, row.route_command)
        if told == before:
            continue
        if before is not None or row.command != Command.LANE_FOLLOW:
            text = name_of(row.command)
            if row.route_command != row.command:
                text += f" (route: {name_of(row.route_command)})"
            side = (row.x - 2.2 * np.sin(-row.yaw), row.y - 2.2 * np.cos(row.yaw))
            dot, at = window.pixels(np.array([(row.x, row.y), side]))
            window.line(image, _circle(row.x, row.y, 0.5), colours.TEXT, 2, closed=True)
            right = at[0] >= dot[0] and at[0] + width_of(text, letter) < window.size
            left = at[0] + letter if right else at[0] - width_of(text, letter) - letter
            write(image, text, (max(left, 2.0), float(at[1])), letter, colours.TEXT, halo=True)
        before = told


def draw_road_users(image: Image, window: Window, users: tuple[RoadUser, ...]) -> None:
    """Draw the other road users: boxes for vehicles, discs for pedestrians."""
    for x, y, yaw, length, width, _ in users:
        if length <= _PEDESTRIAN:
            window.fill(image, [_circle(x, y, max(length, 3.0 / window.scale))], colours.PEDESTRIAN)
        else:
            window.fill(image, [box(x, y, yaw, length, width)], colours.VEHICLE)


def draw_car(image: Image, window: Window, row: Row) -> None:
    """Draw the car with its windscreen, which shows where its front is."""
    window.fill(image, [_body(row)], colours.CAR)
    glass = box(row.x + 0.7 * np.cos(row.yaw), row.y + 0.7 * np.sin(row.yaw), row.yaw, 0.9, 0.75 * VEHICLE.width)
    window.fill(image, [glass], colours.GLASS)


def draw_verdict(image: Image, window: Window, row: Row, outcome: Outcome) -> None:
    """Mark the place of the verdict: a cross for unsafe, a ring for safe, a square for neither; and name it."""
    (said, colour), safety = verdict_of(outcome), safety_of(outcome)
    reach, thick = 22.0 / window.scale * window.size / 720, 4 * window.size / 720
    if safety is Safety.UNSAFE:
        for turn in (0.25, 0.75):
            window.line(image, box(row.x, row.y, window.up + np.pi * turn, 2 * reach, 0)[1:3], colour, thick)
    elif safety is Safety.SAFE:
        window.line(image, _circle(row.x, row.y, reach), colour, thick, closed=True)
    else:
        window.line(image, box(row.x, row.y, window.up, 2 * reach, 2 * reach), colour, thick, closed=True)
    letter = window.size / 40
    x, y = window.pixels(np.array([(row.x, row.y)]))[0].tolist()
    left = min(max(x - width_of(said, letter) / 2, 4.0), window.size - width_of(said, letter) - 4.0)
    down = y + 1.6 * reach * window.scale + letter
    above = y - 1.6 * reach * window.scale
    write(image, said, (left, down if down < window.size - letter else above), letter, colour, halo=True)


def draw_scales(image: Image, window: Window, fastest: float) -> None:
    """Draw the scale of speeds and a measure of length, in the lower corners."""
    letter = window.size / 60
    wide, high = window.size // 4, max(6, window.size // 70)
    left, low = round(letter), window.size - round(3 * letter)
    steps = np.linspace(0, 255, wide).astype(int)
    image[low - high : low, left : left + wide] = colours.SPEEDS[steps]
    for share, text in ((0.0, "0"), (0.5, f"{fastest / 2:g}"), (1.0, f"{fastest:.0f} m/s")):
        write(image, text, (left + share * wide - 4 * bool(share), low + 1.7 * letter), letter, colours.TEXT, halo=True)
    metres = 10.0 if window.extent < 200 else 100.0
    right, long = window.size - round(letter), round(metres * window.scale)
    image[low - high // 2 : low, right - long : right] = colours.TEXT
    text = f"{metres:g} m"
    write(image, text, (right - width_of(text, letter), low + 1.7 * letter), letter, colours.TEXT, halo=True)


def _body(row: Row) -> Points:
    return box(row.x, row.y, row.yaw, VEHICLE.length, VEHICLE.width)


def _circle(x: float, y: float, radius: float) -> Points:
    turn = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    return np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], axis=1)
