"""Maps of junctions with trajectories over them."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.records.evaluation_record import Drive, EvaluationRecord
from wrongturn_client import Client
from wrongturn_client.plugins import LOADERS, entry_points, load
from wrongturn_figures.look import COLUMN, MARKS, PAGE, Mark, mark_of, new_figure, style
from wrongturn_protocol import Command, FaultKind, JunctionType, TownDetail
from wrongturn_protocol.catalogue import ApproachDetail
from wrongturn_protocol.installing import install
from wrongturn_protocol.junction_frame import Frame, Points, rings
from wrongturn_protocol.words import name

FindTown = Callable[[str], TownDetail]
"""Returns a town by its name."""


@lru_cache(maxsize=32)
def installed_town(name: str) -> TownDetail:
    """Return a town that is installed here.

    Raises:
        ResultsError: wrongturn-networks is not installed, or has no such town.
    """
    point = entry_points(LOADERS).get("town")
    if point is None:
        raise ResultsError(f"no towns are installed here; {install('wrongturn-networks')}")
    try:
        found: TownDetail = load(point)(name).detail({})
    except ValueError as error:
        raise ResultsError(str(error)) from error
    return found


def town_of(url: str) -> FindTown:
    """Return a function that gets towns from a service, each once."""

    @lru_cache(maxsize=32)
    def find(name: str) -> TownDetail:
        with Client(url, "", patience=0) as client:
            return client.town(name)

    return find


_ACROSS: Final = (-24.0, 24.0)
_ALONG: Final = (-36.0, 28.0)
"""What a panel shows of an approach's frame, metres."""
_SCALE_M: Final = 10
_ROWS_OF_PAIRS: Final = 2
_ROAD, _KERB, _LINE = "#e6e6e6", "#a6a6a6", "#444444"
_TWIN: Final = Mark("its twin, without a fault", "#555555", (0, (1, 1)), "o")


def trajectories(run: EvaluationRecord, *, width: float = COLUMN, towns: FindTown = installed_town) -> Figure:
    """Draw all trajectories over their junctions, by how they ended: a row for each fault, a column for each type.

    All approaches of a type lie over one another, turned so that the car comes from below. Their kerbs at the side
    without an exit lie on one another, so a cross lies where the road was left.

    The run is from a file or a service, and the width in inches. ``towns`` returns the geometry of a town; see
    :func:`town_of` for those of a service.

    Raises:
        ResultsError: The run has no paths, or no twins, as a suite of journeys.
    """
    drives = [trial for trial, _ in run.pairs()]
    if not any(drive.path for drive in drives):
        raise ResultsError(
            f"{run.agent}: the stored results have no trajectories; give a file of 'wrongturn run --json', or an agent "
            "of a service"
        )
    types = [kind for kind in JunctionType if any(drive.trial.junction_type is kind for drive in drives)]
    faults = [fault for fault in FaultKind if any(drive.trial.fault.kind is fault for drive in drives)]
    with style():
        height = width / len(types) * _shape() * len(faults) + 0.55
        figure = new_figure(width, height)
        axes = figure.subplots(len(faults), len(types), squeeze=False)
        for row, fault in enumerate(faults):
            for column, kind in enumerate(types):
                here = [one for one in drives if (one.trial.junction_type, one.trial.fault.kind) == (kind, fault)]
                _panel(axes[row, column], here, towns)
                unsafe = sum(one.result.unsafe_strict for one in here)
                axes[row, column].set_xlabel(f"{unsafe} of {len(here)} unsafe", labelpad=2)
                if row == 0:
                    axes[row, column].set_title(name(kind), pad=3)
            axes[row, 0].set_ylabel(name(fault))
        _scale_bar(axes[0, 0])
        _legend(figure, drives, width)
    return figure


def beside_twins(
    run: EvaluationRecord, trials: Sequence[str] | None = None, *, width: float = PAGE, towns: FindTown = installed_town
) -> Figure:
    """Draw trials over their twins, a small map for each pair; run, width and towns are as for :func:`trajectories`.

    By default these are unsafe trials, two rows of maps at most, evenly over types and faults.

    Raises:
        ResultsError: The run has no such trial, no unsafe one, no paths, or no twins.
    """
    fitting = max(2, round(width / 1.15))
    chosen = _chosen(list(run.pairs()), trials, run.agent, fitting * _ROWS_OF_PAIRS)
    columns = min(len(chosen), fitting)
    rows = math.ceil(len(chosen) / columns)
    with style():
        figure = new_figure(width, width / columns * (_shape() + 0.28) * rows + 0.4)
        axes = figure.subplots(rows, columns, squeeze=False)
        for place in axes.flat[len(chosen) :]:
            place.set_axis_off()
        for place, (drive, twin) in zip(axes.flat, chosen, strict=False):
            _panel(place, [drive], towns, twin)
            trial = drive.trial
            place.set_title(f"{name(trial.junction_type)}\n{name(trial.fault.kind)}", pad=2)
            place.set_xlabel(f"{trial.approach}", labelpad=2)
        _scale_bar(axes[0, 0])
        _legend(figure, [drive for drive, _ in chosen], width, twins=True)
    return figure


def _chosen(
    found: list[tuple[Drive, Drive]], trials: Sequence[str] | None, agent: str, most: int
) -> list[tuple[Drive, Drive]]:
    """Return the pairs of the named trials, or the first unsafe ones, evenly over types and faults."""
    if not any(trial.path for trial, _ in found):
        raise ResultsError(f"{agent}: the stored results have no trajectories; give a file of 'wrongturn run --json'")
    if trials is not None:
        by_id = {trial.trial.id: (trial, twin) for trial, twin in found}
        unknown = [trial for trial in trials if trial not in by_id]
        if unknown or not trials:
            raise ResultsError(
                f"trials: {unknown[0] if unknown else 'none'}: is no trial of this run; csv_text() lists them"
            )
        return [by_id[trial] for trial in trials]
    cells: dict[tuple[JunctionType, FaultKind], list[tuple[Drive, Drive]]] = {}
    for trial, twin in found:
        if trial.result.unsafe_strict and trial.path:
            cells.setdefault((trial.trial.junction_type, trial.trial.fault.kind), []).append((trial, twin))
    if not cells:
        raise ResultsError(f"{agent}: no trial was unsafe; name the trials to draw")
    chosen: list[tuple[Drive, Drive]] = []
    while len(chosen) < most and any(cells.values()):
        chosen += [pair.pop(0) for pair in cells.values() if pair]
    return chosen[:most]


def _shape() -> float:
    """Return a panel's height over its width."""
    return (_ALONG[1] - _ALONG[0]) / (_ACROSS[1] - _ACROSS[0])


def _panel(axes: Axes, drives: Sequence[Drive], towns: FindTown, twin: Drive | None = None) -> None:
    """Draw the road of the drives' approaches, the twin if any, and the drives."""
    found = {}
    for drive in drives:
        town = towns(drive.trial.town)
        approach = next((one for one in town.approaches if one.id == drive.trial.approach), None)
        if approach is None:
            raise ResultsError(f"{town.name}: has no approach {drive.trial.approach}; the town is another version")
        found[drive.trial.town, approach.id] = (town, approach)
    frames = _frames(found)
    for (town_name, approach_id), frame in frames.items():
        for polygon in rings(towns(town_name).road):
            _draw_road(axes, [frame.turned(ring) for ring in polygon])
        (middle,) = frame.turned([found[town_name, approach_id][1].stop_line])
        axes.plot(middle[0] + [-1.5, 5.0], middle[[1, 1]], color=_LINE, linewidth=0.3, zorder=2)
    if twin is not None and twin.path:
        frame = frames[twin.trial.town, twin.trial.approach]
        _draw_path(axes, frame.turned(twin.path), _TWIN, zorder=3)
    for drive in sorted(drives, key=lambda one: MARKS.index(mark_of(one.result))):
        if drive.path:
            frame = frames[drive.trial.town, drive.trial.approach]
            _draw_path(axes, frame.turned(drive.path), mark_of(drive.result), zorder=4)
    axes.set(xlim=_ACROSS, ylim=_ALONG, aspect="equal", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(linewidth=0.4, color=_KERB)


def _frames(found: Mapping[tuple[str, str], tuple[TownDetail, ApproachDetail]]) -> dict[tuple[str, str], Frame]:
    """Return the approaches' frames, moved so that their kerbs at the side without an exit lie on one another.

    So a cross where a car left the road there lies on the kerb, whatever the size of its junction.
    """
    kerbs = {}
    for key, (town, approach) in found.items():
        frame = Frame(approach.stop_line, approach.heading)
        outline = np.concatenate(
            [frame.turned(ring) for area in rings(town.junctions[approach.junction]) for ring in area]
        )
        kerbs[key] = _kerb(outline, approach.type.missing)
    middle = np.mean(list(kerbs.values()), axis=0)
    frames = {}
    for key, (_, approach) in found.items():
        sin, cos = math.sin(approach.heading), math.cos(approach.heading)
        right, up = kerbs[key] - middle
        x, y = approach.stop_line
        frames[key] = Frame((x + right * sin + up * cos, y - right * cos + up * sin), approach.heading)
    return frames


def _kerb(outline: Points, missing: Command | None) -> Points:
    """Return where a junction's outline, in the approach's frame, is crossed at the side without an exit."""
    low, high = _crossed(outline, 0, 0.0)
    if missing is Command.STRAIGHT:
        return np.array([0.0, high])
    along = (low + high) / 2  # the middle of the crossing street
    left, right = _crossed(outline, 1, along)
    across = left if missing is Command.LEFT else right if missing is Command.RIGHT else 0.0
    return np.array([across, along])


def _crossed(outline: Points, axis: int, at: float) -> tuple[float, float]:
    """Return the first and last place, along the other axis, at which an outline crosses a line."""
    begin, end = outline, np.roll(outline, -1, axis=0)
    across = (begin[:, axis] - at) * (end[:, axis] - at) < 0
    begin, end = begin[across], end[across]
    share = (at - begin[:, axis]) / (end - begin)[:, axis]
    places = begin[:, 1 - axis] + share * (end - begin)[:, 1 - axis]
    return float(places.min()), float(places.max())


def _draw_road(axes: Axes, polygon: Sequence[Points]) -> None:

    # Cut off what a panel does not show, so that a file does not hold the whole town for each panel.
    box = Bbox([[_ACROSS[0] - 2, _ALONG[0] - 2], [_ACROSS[1] + 2, _ALONG[1] + 2]])
    cut = [Path(ring, closed=True).clip_to_bbox(box) for ring in polygon]
    shown = [ring for ring in cut if len(np.asarray(ring.vertices))]
    if shown:
        whole = Path.make_compound_path(*shown)
        axes.add_patch(PathPatch(whole, facecolor=_ROAD, edgecolor="none", zorder=0))
        axes.add_patch(PathPatch(whole, facecolor="none", edgecolor=_KERB, linewidth=0.3, zorder=1))


def _draw_path(axes: Axes, points: Points, mark: Mark, zorder: int) -> None:
    across, along = points.T
    axes.plot(across, along, color=mark.colour, linestyle=mark.dash, linewidth=0.7, zorder=zorder)
    inside = _ACROSS[0] <= across[-1] <= _ACROSS[1] and _ALONG[0] <= along[-1] <= _ALONG[1]
    if inside:
        axes.plot(
            across[-1:], along[-1:], mark.marker, color=mark.colour, markersize=3.2, mec="white", mew=0.3, zorder=5
        )


def _scale_bar(axes: Axes) -> None:
    left, low = _ACROSS[0] + 3, _ALONG[0] + 4
    axes.plot([left, left + _SCALE_M], [low, low], color="#000000", linewidth=1.0, solid_capstyle="butt", zorder=6)
    axes.text(left + _SCALE_M / 2, low + 1, f"{_SCALE_M} m", ha="center", va="bottom", fontsize=6, zorder=6)


def _legend(figure: Figure, drives: Iterable[Drive], width: float, *, twins: bool = False) -> None:

    present = {mark_of(drive.result) for drive in drives}
    shown = [mark for mark in MARKS if mark in present]
    if twins:
        shown.append(_TWIN)
    lines: list[Any] = [
        Line2D(
            [], [], color=mark.colour, ls=mark.dash, marker=mark.marker, ms=3.5, mec="white", mew=0.3, label=mark.name
        )
        for mark in shown
    ]
    figure.legend(handles=lines, loc="outside lower center", ncols=2 if width < 5 else 4, frameon=False, handlelength=3)
