"""An episode as a figure, for notebooks and papers."""

import itertools
from typing import TYPE_CHECKING, Final

import numpy as np

from wrongturn_judge.trajectory import Trajectory
from wrongturn_networks import Town
from wrongturn_protocol import Outcome, Safety
from wrongturn_protocol.installing import install
from wrongturn_sim.errors import DependencyMissingError
from wrongturn_sim.view import colours, scene
from wrongturn_sim.view.window import Points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PIXELS: Final = 1000
_MARKERS: Final = {Safety.UNSAFE: "X", Safety.SAFE: "o", Safety.NEITHER: "s"}


def plot_episode(town: Town, trajectory: Trajectory, outcome: Outcome | None) -> "Figure":
    """Return the figure of :meth:`~wrongturn_sim.Replay.plot`. Raises DependencyMissingError without matplotlib."""
    try:
        from matplotlib import pyplot  # noqa: PLC0415 - an extra
        from matplotlib.collections import LineCollection  # noqa: PLC0415
        from matplotlib.colors import ListedColormap  # noqa: PLC0415
    except ImportError as error:
        raise DependencyMissingError(f"plot: needs matplotlib, which is missing: {install('matplotlib')}") from error
    rows, trial = trajectory.rows, trajectory.trial
    window = scene.whole_window(town, rows, trial.approach, _PIXELS)
    fastest, half = scene.fastest_of(rows), window.extent / 2
    figure, (above, beside) = pyplot.subplots(1, 2, figsize=(10, 5), layout="constrained")
    # Notebooks show figures that pyplot made; those it still holds they would show twice.
    pyplot.close(figure)
    sides = (window.x - half, window.x + half, window.y - half, window.y + half)
    above.imshow(scene.draw_ground(town, window), extent=sides)
    way: Points = np.array([(row.x, row.y) for row in rows])
    pieces = np.stack([way[:-1], way[1:]], axis=1)
    coloured = LineCollection(list(pieces), cmap=ListedColormap(colours.SPEEDS / 255), linewidth=3)
    coloured.set_array(np.array([row.v for row in rows[1:]]))
    coloured.set_clim(0, fastest)
    above.add_collection(coloured)
    figure.colorbar(coloured, ax=above, label="speed, m/s", shrink=0.8)
    above.set(title=trial.id, xlabel="x, m", ylabel="y, m")
    times = [row.t for row in rows]
    beside.plot(times, [row.v for row in rows], color="black")
    beside.set(xlabel="time, s", ylabel="speed, m/s", ylim=(0, fastest), xlim=(0, max(times[-1], 0.1)))
    for begin, end, text in _wrong_commands(trajectory):
        beside.axvspan(begin, end, color="orange", alpha=0.3, linewidth=0)
        beside.text(begin, fastest * 0.97, text, va="top", fontsize="small")
    if outcome is not None:
        said, (red, green, blue) = scene.verdict_of(outcome)
        colour = (red / 255, green / 255, blue / 255)
        above.plot(*way[-1], marker=_MARKERS[scene.safety_of(outcome)], markersize=12, color=colour)
        beside.axvline(outcome.time, color=colour, linestyle="--")
        beside.set_title(said, color=colour)
    return figure


def _wrong_commands(trajectory: Trajectory) -> list[tuple[float, float, str]]:
    """Return the times in which the command was not the route's: begin, end, and both commands."""
    found: list[tuple[float, float, str]] = []
    rows = trajectory.rows
    for before, row in itertools.pairwise(rows):
        if row.command == row.route_command:
            continue
        text = f"{scene.name_of(row.command)}\n(route: {scene.name_of(row.route_command)})"
        if found and found[-1][1:] == (before.t, text):
            found[-1] = (found[-1][0], row.t, text)
        else:
            found.append((before.t, row.t, text))
    return found
