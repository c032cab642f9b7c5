"""The cells of a grid that a polygon touches or covers, compiled. ``packing.py`` asks for them."""

import math

from wrongturn_judge.compiling import compiled
from wrongturn_judge.kernels import Array, inside_listed


@compiled()
def mark_edges(marks: Array, edges: Array, x: float, y: float, size: float) -> None:
    """Mark every cell of ``marks`` (rows, columns) that an edge of ``edges`` (n, 4) touches."""
    slack = 1e-6
    rows, columns = marks.shape
    for k in range(edges.shape[0]):
        x1, y1, x2, y2 = edges[k, 0] - x, edges[k, 1] - y, edges[k, 2] - x, edges[k, 3] - y
        left = max(math.floor((min(x1, x2) - slack) / size), 0)
        right = min(math.floor((max(x1, x2) + slack) / size), columns - 1)
        low = max(math.floor((min(y1, y2) - slack) / size), 0)
        high = min(math.floor((max(y1, y2) + slack) / size), rows - 1)
        nx, ny = y1 - y2, x2 - x1
        reach = (abs(nx) + abs(ny)) * (size / 2 + slack)
        for row in range(low, high + 1):
            for column in range(left, right + 1):
                mx = (column + 0.5) * size - x1
                my = (row + 0.5) * size - y1
                if abs(mx * nx + my * ny) <= reach:
                    marks[row, column] = True


@compiled()
def mark_inside(marks: Array, edges: Array, starts: Array, listed: Array, x: float, y: float, size: float) -> None:
    """Mark every cell whose middle lies in a polygon; ``starts`` and ``listed`` are those of ``Grid.rows_of``."""
    rows, columns = marks.shape
    flat = edges.ravel()
    for row in range(rows):
        for column in range(columns):
            marks[row, column] = inside_listed(
                flat, 0, listed, starts[row], starts[row + 1], x + (column + 0.5) * size, y + (row + 0.5) * size
            )
