"""SUMO's plain XML of a recipe: nodes and edges."""

import math
import xml.etree.ElementTree as ET

from wrongturn_networks.making.recipes import Point, Recipe, Street

SIDEWALK_WIDTH = 2.5
SPEED = 13.89
"""Speed limit of SUMO's traffic: 50 km/h, as in CARLA's towns."""
ARC_STEP = math.radians(3)
"""Angle between the points of a bend, radians."""


def nodes_xml(recipe: Recipe) -> str:
    """Return the ``.nod.xml`` of a recipe."""
    root = ET.Element("nodes")
    radii = recipe.radii()
    for name, (x, y) in recipe.nodes.items():
        node = ET.SubElement(root, "node", id=name, x=f"{x:.2f}", y=f"{y:.2f}")
        if name in radii:
            node.set("type", "priority")
            node.set("radius", f"{radii[name]:.2f}")
    return _text(root)


def edges_xml(recipe: Recipe) -> str:
    """Return the ``.edg.xml`` of a recipe, with two edges for each street."""
    root = ET.Element("edges")
    sizes = {"sidewalkWidth": f"{SIDEWALK_WIDTH:.2f}", "speed": f"{SPEED:.2f}"}
    for street in recipe.streets:
        width = f"{street.lane_width:.2f}"
        centreline = centreline_of(recipe, street)
        for start, end, line in ((street.start, street.end, centreline), (street.end, street.start, centreline[::-1])):
            edge = ET.SubElement(
                root,
                "edge",
                {"id": f"{start}-{end}", "from": start, "to": end, "numLanes": "1"}
                | {"width": width, **sizes, "spreadType": "right"},
            )
            if street.corners:
                edge.set("shape", " ".join(f"{x:.2f},{y:.2f}" for x, y in line))
    return _text(root)


def centreline_of(recipe: Recipe, street: Street) -> list[Point]:
    """Return the street's centre line with rounded corners, metres."""
    points = [recipe.nodes[street.start], *street.corners, recipe.nodes[street.end]]
    line = [points[0]]
    radii = street.bends or [recipe.bend_radius] * len(street.corners)
    for before, corner, after, radius in zip(points, points[1:], points[2:], radii, strict=False):
        line += rounded(before, corner, after, radius)
    return [*line, points[-1]]


def rounded(before: Point, corner: Point, after: Point, radius: float) -> list[Point]:
    """Return the points of the arc that rounds a corner, both ends included."""
    into, out = _unit(before, corner), _unit(corner, after)
    across, along = into[0] * out[1] - into[1] * out[0], into[0] * out[0] + into[1] * out[1]
    turn = math.atan2(across, along)
    # From the arc's start to its centre, on the side to which the street turns.
    inward = (-into[1], into[0]) if turn > 0 else (into[1], -into[0])
    back = radius * abs(across) / (1 + along)  # the tangent of half the turn
    centre = (corner[0] - back * into[0] + radius * inward[0], corner[1] - back * into[1] + radius * inward[1])
    steps = max(1, math.ceil(abs(turn) / ARC_STEP))
    arc = []
    for step in range(steps + 1):
        angle = turn * step / steps
        # The vector from the centre to the arc's start, rotated by the angle.
        x, y = -radius * inward[0], -radius * inward[1]
        arc.append(
            (
                centre[0] + x * math.cos(angle) - y * math.sin(angle),
                centre[1] + x * math.sin(angle) + y * math.cos(angle),
            )
        )
    return arc


def _unit(start: Point, end: Point) -> Point:
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(dx * dx + dy * dy)
    return dx / length, dy / length


def _text(root: ET.Element) -> str:
    ET.indent(root, "    ")
    return ET.tostring(root, "unicode") + "\n"
