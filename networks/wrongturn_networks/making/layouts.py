"""Layouts of drawn towns: a grid of streets, some of which are missing."""

import random
from collections.abc import Iterator
from typing import Final, NamedTuple

import networkx as nx

MISSING: Final = (0.1, 0.35)
"""Least and greatest share of the grid's pieces of street that are left out."""

Node = tuple[int, int]
"""A place of the grid: column and row."""


class Layout(NamedTuple):
    """Which pieces of a grid's streets there are."""

    names: dict[Node, str]
    """Names of the junctions."""
    chains: list[list[Node]]
    """Places of each street, from one junction to the next."""


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
