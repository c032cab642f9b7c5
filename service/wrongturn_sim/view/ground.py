"""A town from above: sidewalks, road, junctions, stop lines, houses and trees."""

import math
from typing import Final

import numpy as np
from shapely import box, get_parts
from shapely.geometry.base import BaseGeometry

from wrongturn_networks import Approach, Lane, Town
from wrongturn_networks.scenery import SceneryKind
from wrongturn_sim.view import colours
from wrongturn_sim.view.colours import Colour
from wrongturn_sim.view.window import Image, Points, Window

_PLANTS: Final = {SceneryKind.TREE, SceneryKind.HEDGE}
_STOP_LINE: Final = 0.4
"""Width of a stop line, metres."""


def draw_ground(town: Town, window: Window) -> Image:
    """Return the town's part that a window shows, without any road user."""
    image = np.full((window.size, window.size, 3), colours.GROUND, np.uint8)
    half = window.extent / 2 + 1.0
    shown = box(window.x - half, window.y - half, window.x + half, window.y + half)
    _area(image, window, town.sidewalks.intersection(shown), colours.SIDEWALK)
    _scenery(image, window, town)
    _area(image, window, town.road.intersection(shown), colours.ROAD)
    for junction in town.junctions.values():
        if junction.area.intersects(shown):
            _area(image, window, junction.area, colours.JUNCTION)
    for ring in _rings(town.road.intersection(shown)):
        window.line(image, ring, colours.EDGE, 1, closed=True)
    for approach in town.approaches.values():
        line = stop_line_of(approach, town.lanes[approach.lane])
        window.line(image, line, colours.STOP_LINE, _STOP_LINE * window.scale)
    return image


def stop_line_of(approach: Approach, lane: Lane) -> Points:
    """Return both ends (2, 2) of an approach's stop line, across its lane."""
    across = np.array([-math.sin(approach.heading), math.cos(approach.heading)]) * lane.width / 2
    return np.array(approach.stop_line) + np.stack([across, -across])


def _area(image: Image, window: Window, area: BaseGeometry, colour: Colour) -> None:
    rings = _rings(area)
    if rings:
        window.fill(image, rings, colour)


def _rings(area: BaseGeometry) -> list[Points]:
    """Return the outlines and the holes of an area's polygons."""
    polygons = [part for part in get_parts(area) if part.geom_type == "Polygon" and not part.is_empty]
    return [np.array(ring.coords) for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]


def _scenery(image: Image, window: Window, town: Town) -> None:
    for thing in town.scenery:
        reach = thing.length + thing.width + window.extent / 2
        if max(abs(thing.x - window.x), abs(thing.y - window.y)) > reach:
            continue
        colour = colours.PLANT if thing.kind in _PLANTS else colours.BUILDING
        footprint = thing.footprint()
        if thing.crown_radius:
            footprint = footprint.centroid.buffer(thing.crown_radius)
        window.fill(image, [np.array(footprint.exterior.coords)], colour)
