"""Recipes of generated towns: a grid of streets, some of which are missing, drawn from a seed."""

import random
from collections.abc import Iterator
from itertools import pairwise
from typing import Final, NamedTuple

import networkx as nx

from wrongturn_networks.making.recipes import Point, Recipe, Street

COLUMNS: Final = (3, 4, 5)
ROWS: Final = (3, 4)
"""Numbers of streets from south to north, and from west to east."""
SPACING: Final = (48.0, 100.0)
"""Least and greatest distance between neighbouring streets, metres."""
MISSING: Final = (0.1, 0.35)
"""Least and greatest share of the grid's pieces of street that are left out."""
_BEND_RADII: Final = (8.0, 14.0)
_TRIES: Final = 1000

Node = tuple[int, int]
"""A place of the grid: column and row."""


class Layout(NamedTuple):
    """Which pieces of a grid's streets there are."""

    names: dict[Node, str]
    """Names of the junctions."""
    chains: list[list[Node]]
    """Places of each street, from one junction to the next."""


def generated_recipe(seed: int) -> Recipe:
    """Return the recipe of a town that is drawn from a seed; equal seeds give equal towns.

    The town is a grid with streets left out, so that its junctions have three or four arms. Places where two streets
    meet become bends or straight streets, and there are no dead ends. Its name is ``generated-`` and the seed. Raises
    ValueError if that is negative.
    """
    if seed < 0:
        raise ValueError(f"seed: is {seed}; give a whole number from 0 on")
    draw = random.Random(f"town {seed}")
    for _ in range(_TRIES):
        drawn = _drawn(draw, f"generated-{seed}", seed)
        if drawn is not None:
            return drawn
    raise RuntimeError(f"seed: none of {_TRIES} layouts of seed {seed} makes a town; take another seed")


def _drawn(draw: random.Random, name: str, seed: int) -> Recipe | None:
    """Return a town; None if the layout that was drawn makes none."""
    columns, rows = draw.choice(COLUMNS), draw.choice(ROWS)
    xs, ys = lines(draw, columns, SPACING), lines(draw, rows, SPACING)
    layout = drawn_layout(draw, columns, rows)
    if layout is None:
        return None
    names, chains = layout
    streets = [
        Street(names[chain[0]], names[chain[-1]], tuple((xs[i], ys[j]) for i, j in _corners(chain))) for chain in chains
    ]
    nodes: dict[str, Point] = {label: (xs[i], ys[j]) for (i, j), label in names.items()}
    return Recipe(name, nodes, tuple(streets), seed, bend_radius=round(draw.uniform(*_BEND_RADII), 2))


def drawn_layout(draw: random.Random, columns: int, rows: int) -> Layout | None:
    """Return which pieces of a grid's streets there are; None if those that were drawn make no town."""
    places = [(i, j) for i in range(columns) for j in range(rows)]
    pieces = [
        ((i, j), (i + di, j + dj)) for i, j in places for di, dj in ((1, 0), (0, 1)) if (i + di, j + dj) in places
    ]
    kept = draw.sample(pieces, round(len(pieces) * (1.0 - draw.uniform(*MISSING))))
    grid = nx.k_core(nx.Graph(kept), 2)  # without dead ends
    junctions = sorted(node for node, arms in grid.degree if arms > 2)
    names = {node: f"J{number}" for number, node in enumerate(junctions, 1)}
    chains = list(_chains(grid, names))
    ends = [frozenset((chain[0], chain[-1])) for chain in chains]
    # SUMO's edges are named after their ends, so two streets cannot join the same junctions, nor one lead back.
    if len(names) < 4 or len(set(ends)) < len(ends) or min(map(len, ends)) < 2 or not nx.is_connected(grid):
        return None
    return Layout(names, chains)


def lines(draw: random.Random, count: int, spacing: tuple[float, float]) -> list[float]:
    """Return where a number of parallel streets lie, metres."""
    places = [0.0]
    for _ in range(count - 1):
        places.append(round(places[-1] + draw.uniform(*spacing), 2))
    return places


def _chains(grid: "nx.Graph[Node]", names: dict[Node, str]) -> Iterator[list[Node]]:
    """Yield the nodes of each street, from one junction to the next."""
    for start in names:
        for step in sorted(grid[start]):
            chain = [start, step]
            while chain[-1] not in names:
                (onward,) = grid[chain[-1]].keys() - {chain[-2]}
                chain.append(onward)
            # Each street is found from both of its ends.
            if chain <= chain[::-1]:
                yield chain


def _corners(chain: list[Node]) -> list[Node]:
    """Return the nodes at which a street turns."""
    along = [(before[0] == after[0]) for before, after in pairwise(chain)]
    return [node for node, (into, out) in zip(chain[1:], pairwise(along), strict=False) if into != out]
