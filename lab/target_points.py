"""Target points at each junction type, for ``docs/rigs.md``: ``python -m lab.target_points`` draws them and measures.

It prints how far the constructed way is from the real one where there is an exit.
"""

import math
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np

from wrongturn_networks import Town, draw_trial, load_suite, load_town
from wrongturn_protocol import DIRECTIONS, PAPER_TYPES, Command, FaultKind, Fork, Rig, Trial
from wrongturn_sim import Episode
from wrongturn_sim.navigation import ACROSS, RADII, place_past
from wrongturn_sim.polyline import Polyline
from wrongturn_sim.roads import roads_of

PICTURE: Final = Path("docs/pictures/target-points.webp")
FAR: Final = 45
"""Metres that a picture shows to each side."""
RIG: Final = Rig(navigation=("command", "target_points"))


def trial_at(town: Town, kind: Any) -> Trial:
    """Return a trial without a fault at the first approach of a type."""
    approach = next(name for name, one in town.approaches.items() if one.type is kind)
    return draw_trial(town, approach, FaultKind.NONE, 0)


def points_along(trial: Trial, command: Command) -> tuple[list[tuple[float, float]], np.ndarray[Any, Any]]:
    """Return where the points lie, in the town's frame, as the car drives to the stop line; and its track."""
    episode = Episode(trial.model_copy(update={"fork": Fork(decision=0, command=command)}), RIG)
    seen, found, driven = episode.reset(), set(), []
    while episode.outcome is None:
        x, y, yaw = episode.trajectory.rows[-1][1:4]
        driven.append((x, y))
        for ahead, left in seen["target_points"].tolist():
            at = x + ahead * math.cos(yaw) - left * math.sin(yaw), y + ahead * math.sin(yaw) + left * math.cos(yaw)
            found.add((round(at[0], 1), round(at[1], 1)))
        if len(driven) > 80:
            break
        step = episode.step(0.0, 0.4 if seen["speed"][0] < 6.0 else 0.0, 0.0)
        seen = step.observation
    return sorted(found), np.array(driven)


def draw(town: Town) -> None:
    """Draw each command at each junction type."""
    figure, axes = plt.subplots(len(PAPER_TYPES), 3, figsize=(9, 9), constrained_layout=True)
    for row, kind in zip(axes, PAPER_TYPES, strict=True):
        trial = trial_at(town, kind)
        for axis, command in zip(row, DIRECTIONS, strict=True):
            points, driven = points_along(trial, command)
            for lane in town.lanes.values():
                line = np.array(lane.centreline)
                axis.plot(*line.T, color="0.82", linewidth=13, solid_capstyle="butt", zorder=0)
            exits = town.approaches[trial.approach].exits
            for leaving in exits.values():
                axis.plot(*np.array(leaving.path).T, color="0.82", linewidth=13, zorder=0)
            axis.plot(*driven.T, color="tab:blue", linewidth=1.5)
            axis.scatter(*np.array(points).T, color="tab:orange" if command in exits else "tab:red", zorder=3)
            x, y = town.lanes[town.approaches[trial.approach].lane].centreline[-1]
            axis.set(xlim=(x - FAR, x + FAR), ylim=(y - FAR, y + FAR), xticks=(), yticks=(), aspect="equal")
            road = "a road leads there" if command in exits else "no road"
            axis.set_title(f"{kind.value.replace('_', ' ').lower()}: {command.name.lower()}, {road}", fontsize=9)
    figure.savefig(PICTURE, dpi=90, pil_kwargs={"quality": 60})


def deviations(town: Town) -> list[float]:
    """Return how far two points of the construction are from the real way at each exit of a town, metres."""
    roads, found = roads_of(town), []
    for approach in town.approaches.values():
        leg = roads.legs[approach.lane]
        end = roads.lanes[leg].at(roads.lanes[leg].length)
        for direction in approach.exits:
            points, _ = roads.path_of(leg, roads.gate_of(leg, direction))
            real = Polyline(points)
            turn = RADII.get(direction, 0.0) * math.pi / 2 or ACROSS
            for past in (turn, turn + 20.0):
                x, y = place_past(end, past, direction)
                ways = [real.at(s)[:2] for s in np.arange(0.0, min(real.length, past + 30.0), 0.25).tolist()]
                found.append(min(math.hypot(x - a, y - b) for a, b in ways))
    return found


def main() -> None:
    """Draw the picture, and print the deviations."""
    draw(load_town("Town01"))
    suite = load_suite("wrong-command-unseen@1")
    drawn = [load_town(town) for town in sorted({trial.town for trial in suite.trials})]
    for name, towns in (("Town01", [load_town("Town01")]), ("Town02", [load_town("Town02")]), ("drawn", drawn)):
        found = [one for town in towns for one in deviations(town)]
        print(
            f"{name}: {len(found)} points, median {np.median(found):.2f} m, 95 % below {np.quantile(found, 0.95):.2f}"
        )


if __name__ == "__main__":
    main()
