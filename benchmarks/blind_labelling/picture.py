"""Draws a drive from above. The picture shows neither the driver, the fault, the route nor a verdict.

The map turns with the approach: the car always comes from below. Lines drawn on it are those of the definitions.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from shapely.geometry.base import BaseGeometry

from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import Approach, Lane, Town, town_of
from wrongturn_protocol import VEHICLE, Command

INCHES, DOTS = 10.0, 100
ROUND: Final = 18.0
"""Metres of map around the junction."""
STANDS: Final = 0.02
"""A car below this speed stands, in the list beside the map, m/s."""
PER_SECOND: Final = 20
COMMANDS: Final = {
    Command.LEFT: "#d62728",
    Command.RIGHT: "#1f77b4",
    Command.STRAIGHT: "#2ca02c",
    Command.LANE_FOLLOW: "#cccccc",
    Command.VOID: "#000000",
}

Points = NDArray[np.float64]


class Frame:
    """Turns the town's coordinates: the stop line's middle is the origin, and the approach leads upwards."""

    def __init__(self, approach: Approach) -> None:
        self._origin = np.array(approach.stop_line)
        turn = math.pi / 2 - approach.heading
        self.turn = turn
        self._matrix = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])

    def of(self, points: Any) -> Points:
        """Return (n, 2) points in this frame."""
        turned: Points = (np.asarray(points, np.float64)[:, :2] - self._origin) @ self._matrix
        return turned


def draw(trajectory: Trajectory, number: int, file: Path) -> None:
    """Write the picture of a drive, with few colours so that the file is small."""
    town = town_of(trajectory.trial)
    approach = town.approach(trajectory.trial.approach)
    frame = Frame(approach)
    figure = Figure(figsize=(INCHES, INCHES), dpi=DOTS)
    figure.text(0.01, 0.975, f"{number:03d}", size=18, weight="bold")
    axes = figure.add_axes((0.035, 0.345, 0.765, 0.645))
    _draw_roads(axes, town, approach, frame)
    _draw_car(axes, trajectory.rows, frame)
    _frame_map(axes, town, approach, frame)
    figure.text(0.805, 0.97, _stops(trajectory.rows, frame), size=8, va="top", family="monospace")
    _draw_times(figure, trajectory.rows, frame)
    figure.savefig(file)
    _shrink(file)


def _draw_roads(axes: Any, town: Town, approach: Approach, frame: Frame) -> None:
    _fill(axes, town.road, frame, color="#e4e4e4", zorder=0)
    _edge(axes, town.road, frame, color="black", linewidth=1.2, zorder=2)
    for item in town.scenery:
        if item.solid:
            _fill(axes, item.footprint(), frame, color="#8c564b", zorder=1)
    for junction in town.junctions.values():
        own = junction.id == approach.junction
        _fill(axes, junction.area, frame, color="#ffe08a" if own else "#f7c6ff", zorder=1)
        if own:
            _edge(axes, junction.area.buffer(20.0), frame, color="#e377c2", linestyle=":", linewidth=1)
    for lane in town.lanes.values():
        _draw_lane(axes, lane, frame)
    for way in approach.exits.values():
        axes.plot(*frame.of(way.path).T, color="#9467bd", linestyle="--", linewidth=0.8, zorder=2)
        for metres, style in ((0.0, "-"), (10.0, ":")):
            _across(axes, town.lanes[way.lane], frame, metres, color="#9467bd", linestyle=style, linewidth=1.6)
    own_lane = town.lanes[approach.lane]
    _across(axes, own_lane, frame, own_lane.length, color="red", linewidth=2.0)
    _across(axes, own_lane, frame, own_lane.length - 15.0, color="red", linestyle=":", linewidth=1.2)


def _draw_lane(axes: Any, lane: Lane, frame: Frame) -> None:
    """Draw a lane's edges and arrows in its direction."""
    _edge(axes, lane.polygon, frame, color="#999999", linewidth=0.6, zorder=1)
    line = frame.of(lane.centreline)
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
    for place in np.arange(4.0, along[-1] - 2.0, 9.0):
        (x, x2), (y, y2) = (np.interp((place, place + 2.5), along, line[:, axis]) for axis in (0, 1))
        if math.hypot(x, y) < 90:
            arrow = {"arrowstyle": "->", "color": "#777777"}
            axes.annotate("", (x2, y2), (x, y), arrowprops=arrow, annotation_clip=True)


def _draw_car(axes: Any, rows: list[Row], frame: Frame) -> None:
    """Draw the body twice a second while it moves, its wheels' tracks, and the time of each whole second."""
    states = np.array([row[1:4] for row in rows])
    centres, headings = frame.of(states), states[:, 2] + frame.turn
    colours = mpl.colormaps["turbo"](np.linspace(0.05, 0.95, 13))
    for ahead in (0.0, VEHICLE.wheelbase):
        for side in (-VEHICLE.half_track, VEHICLE.half_track):
            away = ahead - VEHICLE.rear_axle
            axes.plot(*_points(centres, headings, away, side).T, color="#555555", linewidth=0.35, zorder=3)
    axes.plot(*centres.T, color="black", linewidth=0.9, zorder=4)
    corners = [
        (a * VEHICLE.half_length, b * VEHICLE.half_width) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1))
    ]
    shown = labelled = np.full(2, np.inf)
    for k in range(0, len(rows), PER_SECOND // 2):
        if math.dist(centres[k], shown) < 0.3:
            continue
        shown = centres[k]
        colour = colours[(k // PER_SECOND) % len(colours)]
        body = np.array([_points(centres[k : k + 1], headings[k : k + 1], *corner)[0] for corner in corners])
        whole = k % PER_SECOND == 0
        axes.plot(*body.T, color=colour, linewidth=1.2 if whole else 0.5, zorder=5)
        if whole and math.dist(centres[k], labelled) > 0.9:
            labelled = centres[k]
            axes.text(
                *centres[k],
                f"{k // PER_SECOND}",
                size=7,
                color="black",
                ha="center",
                va="center",
                zorder=7,
                clip_on=True,
            )
    for begin, end in _standing(rows):
        axes.plot(*centres[begin], marker="o", markersize=11, markerfacecolor="none", color="red", zorder=8)
        text = f"{(end - begin) / PER_SECOND:.1f} s"
        axes.annotate(
            text,
            centres[begin],
            (9, 6),
            textcoords="offset points",
            size=8,
            color="red",
            zorder=9,
            annotation_clip=True,
        )


def _frame_map(axes: Any, town: Town, approach: Approach, frame: Frame) -> None:
    """Show the junction and some metres around it, with a grid of 5 m."""
    area = town.junctions[approach.junction].area
    points = frame.of(np.array(area.convex_hull.exterior.coords))
    (left, low), (right, high) = points.min(axis=0) - ROUND, points.max(axis=0) + ROUND
    half = max(right - left, high - low) / 2
    x, y = (left + right) / 2, (low + high) / 2
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
    axes.set_xticks(np.arange(math.ceil((x - half) / 5) * 5, x + half, 5))
    axes.set_yticks(np.arange(math.ceil((y - half) / 5) * 5, y + half, 5))
    axes.grid(color="#bbbbbb", linewidth=0.4)
    axes.tick_params(labelsize=7)


def _draw_times(figure: Any, rows: list[Row], frame: Frame) -> None:
    """Draw speed, slow speed, command, and distance to the stop line over time."""
    times = [row.t for row in rows]
    speeds = [row.v for row in rows]
    before = -frame.of([row[1:3] for row in rows])[:, 1]
    panels = (
        ("speed, m/s", speeds, None),
        ("slow, m/s", speeds, (0.0, 1.0)),
        ("to stop line, m", before, (-50.0, 60.0)),
    )
    for k, (name, values, limits) in enumerate(panels):
        axes = figure.add_axes((0.06, 0.235 - 0.1 * k, 0.925, 0.085))
        axes.plot(times, values, color="black", linewidth=0.9)
        for begin, end in _runs([row.command for row in rows]):
            colour = COMMANDS[Command(rows[end - 1].command)]
            axes.axvspan(
                times[begin], times[end - 1], ymax=1.0 if k == 0 else 0.08, color=colour, alpha=0.35, linewidth=0
            )
            if k == 0 and end - begin > len(rows) / 12:
                axes.text(times[begin], 0.5, f" {Command(rows[end - 1].command).name}", size=7, va="bottom")
        axes.set_ylim(*(limits or (0.0, max(values) + 1.0)))
        axes.set_xlim(0, times[-1])
        axes.set_xticks(np.arange(0, times[-1], 2))
        axes.set_xticks(np.arange(0, times[-1], 1), minor=True)
        axes.grid(which="both", color="#cccccc", linewidth=0.4)
        axes.tick_params(labelsize=7)
        axes.set_ylabel(name, size=7)


def _stops(rows: list[Row], frame: Frame) -> str:
    """Return the list of places where the car stood."""
    places = frame.of([row[1:3] for row in rows])
    lines = ["stands (below 0.02 m/s)", "  from     to     for", ""]
    for begin, end in _standing(rows):
        lines.append(f"{rows[begin].t:6.2f} {rows[end - 1].t:6.2f} {rows[end - 1].t - rows[begin].t:6.2f} s")
        x, y = places[begin]
        lines.append(f"  at x {x:.1f} y {y:.1f}")
    lines += ["", f"ends {rows[-1].t:.2f} s", "", "x, y: centre, metres", "yellow: junction area", "red: stop line,"]
    lines += [
        "  dots 15 m before it",
        "purple: exit lines,",
        "  dots 10 m past them",
        "pink dots: 20 m from",
        "  the junction area",
        "grid: 5 m",
    ]
    return "\n".join(lines)


def _standing(rows: list[Row]) -> list[tuple[int, int]]:
    """Return first and end row of each stretch of half a second or more in which the car stands."""
    still = _runs([row.v < STANDS for row in rows])
    return [(begin, end) for begin, end in still if rows[begin].v < STANDS and end - begin > PER_SECOND // 2]


def _runs(values: list[Any]) -> list[tuple[int, int]]:
    """Return first and end index of each run of equal values."""
    edges = [0, *(k for k in range(1, len(values)) if values[k] != values[k - 1]), len(values)]
    return list(pairwise(edges))


def _points(centres: Points, headings: Points, ahead: float, left: float) -> Points:
    """Return points of the body, (n, 2), by their place relative to its centre."""
    cos, sin = np.cos(headings), np.sin(headings)
    return centres + np.stack((ahead * cos - left * sin, ahead * sin + left * cos), axis=1)


def _across(axes: Any, lane: Lane, frame: Frame, metres: float, **style: Any) -> None:
    """Draw a line across a lane."""
    line = frame.of(lane.centreline)
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
    near = max(0.0, min(metres, along[-1] - 0.1))
    here, ahead = (np.array([np.interp(at, along, line[:, axis]) for axis in (0, 1)]) for at in (near, near + 0.1))
    left = np.array((here[1] - ahead[1], ahead[0] - here[0])) / 0.1 * lane.width / 2
    axes.plot(*np.stack((here - left, here + left)).T, zorder=6, **style)


def _parts(geometry: BaseGeometry) -> list[Any]:
    return list(getattr(geometry, "geoms", [geometry]))


def _fill(axes: Any, geometry: BaseGeometry, frame: Frame, **style: Any) -> None:
    for part in _parts(geometry):
        rings = [frame.of(np.array(ring.coords)) for ring in (part.exterior, *part.interiors)]
        codes = [code for ring in rings for code in (1, *(2,) * (len(ring) - 2), 79)]
        shape = mpl.path.Path(np.concatenate(rings), codes)
        axes.add_patch(mpl.patches.PathPatch(shape, linewidth=0, **style))


def _edge(axes: Any, geometry: BaseGeometry, frame: Frame, **style: Any) -> None:
    for part in _parts(geometry):
        for ring in (part.exterior, *part.interiors):
            axes.plot(*frame.of(np.array(ring.coords)).T, **style)


def _shrink(file: Path) -> None:
    """Write the picture again with a palette of 128 colours."""
    Image.open(file).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)
