"""What an imported town offers: its approaches by type, the trials that fit, and what was left out; and its map."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

from shapely.geometry.base import BaseGeometry

from wrongturn_networks.faults import faults_at
from wrongturn_networks.netfile import read_net
from wrongturn_networks.town import Town
from wrongturn_protocol import JunctionType
from wrongturn_protocol.words import name as word

_COLOURS: Final = dict(zip(JunctionType, ("#0072b2", "#d55e00", "#009e73", "#cc79a7"), strict=True))


def report_of(town: Town, left_out: Mapping[str, str]) -> dict[str, Any]:
    """Return what a town offers as plain values; lengths in metres."""
    lengths = defaultdict(list)
    for approach in town.approaches.values():
        lengths[approach.type].append(town.lanes[approach.lane].length)
    fits = Counter(kind for approach in town.approaches for kind in faults_at(town, approach))
    return {
        "town": town.name,
        "sha256": town.sha256,
        "junctions": len(town.junctions),
        "approaches": {
            kind.value: {"count": len(found), "shortest": round(min(found), 1), "longest": round(max(found), 1)}
            for kind in JunctionType
            if (found := lengths[kind])
        },
        "approaches_by_fault": {str(kind): count for kind, count in fits.items()},
        "left_out": dict(left_out),
    }


def report_lines(report: Mapping[str, Any]) -> list[str]:
    """Return a report as lines of text."""
    lines = [f"{report['town']}: {report['junctions']} junctions", "", "approaches            number  lane m"]
    for kind, found in report["approaches"].items():
        span = f"{found['shortest']:.0f} to {found['longest']:.0f}"
        lines.append(f"  {word(JunctionType(kind)):<20}{found['count']:>6}  {span}")
    lines += ["", "approaches at which a trial of each fault fits"]
    lines += [f"  {kind:<20}{count:>6}" for kind, count in report["approaches_by_fault"].items()]
    if report["left_out"]:
        lines += ["", f"left out: {len(report['left_out'])} junctions and single approaches"]
        lines += [f"  {place}: {reason}" for place, reason in report["left_out"].items()]
    return lines


def write_map(town: Town, left_out: Mapping[str, str], file: Path) -> None:
    """Write a town's map as SVG: roads, approaches coloured by type, and crosses with reasons. Raises OSError."""
    west, south, east, north = town.bounds
    size = max(east - west, north - south) / 100
    marks = []
    for approach in town.approaches.values():
        x, y = approach.stop_line
        title = f"{approach.id}: {word(approach.type)}"
        marks.append(
            f'<circle cx="{x:.1f}" cy="{-y:.1f}" r="{0.6 * size:.2f}" fill="{_COLOURS[approach.type]}">'
            f"<title>{escape(title)}</title></circle>"
        )
    for junction in town.junctions.values():
        x, y = junction.position
        marks.append(f'<text x="{x:.1f}" y="{-y:.1f}" font-size="{2 * size:.2f}">{escape(junction.id)}</text>')
    places = _places(town)
    for place, reason in left_out.items():
        if place in places:
            x, y = places[place]
            cross = f'd="M-1,-1L1,1M1,-1L-1,1" transform="translate({x:.1f} {-y:.1f}) scale({size:.2f})"'
            marks.append(f'<path {cross} stroke="#c00" stroke-width="0.3"><title>{escape(reason)}</title></path>')
    box = f"{west - 3 * size:.1f} {-north - 3 * size:.1f} {east - west + 6 * size:.1f} {north - south + 6 * size:.1f}"
    file.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" font-family="sans-serif">'
        f'<rect x="{west - 3 * size:.1f}" y="{-north - 3 * size:.1f}" width="100%" height="100%" fill="#fff"/>'
        f'<path d="{_path(town.road)}" fill="#bbb" fill-rule="evenodd"/>{"".join(marks)}</svg>\n',
        "utf-8",
    )


def _places(town: Town) -> dict[str, tuple[float, float]]:
    """Return where the net's nodes lie, and where its lanes end, metres."""
    nodes = {node: one.position for node, one in read_net(town.net_file).junctions.items()}
    ends = {lane.id: (float(lane.centreline[-1, 0]), float(lane.centreline[-1, 1])) for lane in town.lanes.values()}
    return {**nodes, **ends}


def _path(area: BaseGeometry) -> str:
    parts = getattr(area, "geoms", [area])
    rings = [ring for part in parts if part.geom_type == "Polygon" for ring in (part.exterior, *part.interiors)]
    return "".join("M" + "L".join(f"{x:.1f},{-y:.1f}" for x, y in ring.coords) + "Z" for ring in rings)
