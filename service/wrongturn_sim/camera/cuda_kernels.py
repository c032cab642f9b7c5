"""The ray caster on a GPU: the functions of :mod:`~wrongturn_sim.camera.raycast`, compiled by ``numba.cuda``.

First, a block of threads for each picture finds what the pixels of each row have in common, and in which columns each
solid may be seen. Then a thread paints each column. Last, where it rains, a thread for each column paints its drops.
Numba's simulator runs the same kernels without a GPU: ``NUMBA_ENABLE_CUDASIM=1 NUMBA_DISABLE_JIT=1``.
"""

from typing import Any, Final

import numpy as np

if not hasattr(np, "row_stack"):
    # NumPy 2.5 removed it, but numba-cuda still uses it.
    setattr(np, "row_stack", np.vstack)  # noqa: B010

import numba.cuda

from wrongturn_sim.camera.backdrop import set_row
from wrongturn_sim.camera.kernels import WORK, Scene, Scratch, eye_of, kernel
from wrongturn_sim.camera.raycast import column_into, rain, show
from wrongturn_sim.camera.road_users import row_of_other
from wrongturn_sim.camera.sight import span_of

# Numba would warn about each launch for a few pictures, which egos that start a new trial need.
setattr(numba.config, "CUDA_LOW_OCCUPANCY_WARNINGS", 0)  # noqa: B010 - numba creates its settings when it is imported

LOW: Final = 64
"""Most rows of a picture whose column fits a thread's own memory, which is faster."""

# Columns of a picture's numbers: the pose, what decides the rain, the row of the look, the picture's place, and which
# of the road users are its own: the first one and their number.
PX, PY, YAW, SEED, TICK, LOOK, TARGET, BEGIN, OTHERS = range(9)
NUMBERS: Final = 9

cuda: Any = numba.cuda
"""Numba's simulator needs this name in this module."""

_LOCAL: Final = (WORK, LOW)


@cuda.jit(fastmath=True)
def look_around(
    numbers: Any, looks: Any, cameras: Any, scenery: Any, items: int, others: Any, width: int, height: int, rows: Any,
    place: Any, spans: Any, users: Any,
) -> None:  # fmt: skip
    """Set ``rows``, ``place``, ``spans`` and ``users``, with a block for each picture.

    Shapes: ``cameras`` (places, LEVEL + 1), packed, that of each place; ``others`` (M, 8), those of all pictures;
    ``rows`` (N, ROWS, height), ``place`` and ``spans`` (N, scenery + most, 2), ``users`` (N, most, COLUMNS). A span
    is the first column in which a solid may be seen, and the one after the last. Road users follow the scenery.
    """
    i = cuda.blockIdx.x
    camera = cameras[int(numbers[i, TARGET])]
    eye = eye_of(numbers[i, PX], numbers[i, PY], numbers[i, YAW], camera)
    for item in range(cuda.threadIdx.x, items, cuda.blockDim.x):
        begin, end = span_of(scenery[item], eye, camera, width, height, place[i, item])
        spans[i, item, 0] = begin
        spans[i, item, 1] = end
    first, count, still = int(numbers[i, BEGIN]), int(numbers[i, OTHERS]), scenery.shape[0]
    for other in range(cuda.threadIdx.x, count, cuda.blockDim.x):
        row = users[i, other]
        row_of_other(others[first + other], row)
        begin, end = span_of(row, eye, camera, width, height, place[i, still + other])
        spans[i, still + other, 0] = begin
        spans[i, still + other, 1] = end
    look = looks[int(numbers[i, LOOK])]
    for v in range(cuda.threadIdx.x, height, cuda.blockDim.x):
        set_row(v, camera, look, rows[i])


@kernel
def paint_column(
    i: int, u: int, numbers: Any, looks: Any, cameras: Any, scene: Scene, rows: Any, place: Any, spans: Any,
    counts: Any, lists: Any, users: Any, canvas: Any, work: Any, rgb: Any, segmentation: Any,
) -> None:  # fmt: skip
    """Paint column u of picture i; ``work`` is for this column alone, the other arrays are for all pictures."""
    count = 0
    for item in range(scene.scenery.shape[0] + int(numbers[i, OTHERS])):
        if spans[i, item, 0] <= u < spans[i, item, 1]:
            lists[i, count, u] = item
            count += 1
    counts[i, u] = count
    # Neighbours' lists side by side, for threads that read them at once.
    scratch = Scratch(rows[i], work, place[i], counts[i], lists[i].T, users[i], canvas[i])
    camera = cameras[int(numbers[i, TARGET])]
    eye = eye_of(numbers[i, PX], numbers[i, PY], numbers[i, YAW], camera)
    column_into(u, eye, camera, looks[int(numbers[i, LOOK])], scene, scratch)
    target = int(numbers[i, TARGET])
    for v in range(segmentation.shape[1]):
        show(v, u, canvas[i], rgb[target], segmentation[target])


@cuda.jit(fastmath=True)
def paint_low(
    numbers: Any, looks: Any, cameras: Any, ground: Any, frame: Any, scenery: Any, shops: Any, cover: Any, rows: Any,
    place: Any, spans: Any, counts: Any, lists: Any, users: Any, canvas: Any, rgb: Any, segmentation: Any,
) -> None:  # fmt: skip
    """Paint pictures of at most LOW rows, with a thread for each column."""
    i, u = cuda.blockIdx.x, cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    work = cuda.local.array(_LOCAL, np.float64)
    if u < segmentation.shape[2]:
        scene = Scene(ground, frame, scenery, shops, cover)
        paint_column(
            i, u, numbers, looks, cameras, scene, rows, place, spans, counts, lists, users, canvas, work, rgb,
            segmentation,
        )  # fmt: skip


@cuda.jit(fastmath=True)
def paint_tall(
    numbers: Any, looks: Any, cameras: Any, ground: Any, frame: Any, scenery: Any, shops: Any, cover: Any, rows: Any,
    place: Any, spans: Any, counts: Any, lists: Any, users: Any, canvas: Any, work: Any, rgb: Any, segmentation: Any,
) -> None:  # fmt: skip
    """Paint pictures of any height, with a thread for each column; ``work`` is (N, WORK, rows, columns)."""
    i, u = cuda.blockIdx.x, cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    if u < segmentation.shape[2]:
        scene, mine = Scene(ground, frame, scenery, shops, cover), work[i, :, :, u]
        paint_column(
            i, u, numbers, looks, cameras, scene, rows, place, spans, counts, lists, users, canvas, mine, rgb,
            segmentation,
        )  # fmt: skip


@cuda.jit(fastmath=True)
def rain_down(numbers: Any, looks: Any, rgb: Any) -> None:
    """Paint the rain, with a thread for each column."""
    i, u = cuda.blockIdx.x, cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    if u < rgb.shape[2]:
        look = looks[int(numbers[i, LOOK])]
        rain(u, u + 1, look, int(numbers[i, SEED]), int(numbers[i, TICK]), rgb[int(numbers[i, TARGET])])


@cuda.jit
def keep(which: Any, rgb: Any, segmentation: Any, kept_rgb: Any, kept_segmentation: Any) -> None:
    """Copy some pictures, with a row of blocks for each."""
    i = int(which[cuda.blockIdx.x])
    width = segmentation.shape[2]
    first, step = cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x, cuda.gridDim.y * cuda.blockDim.x
    for place in range(first, segmentation.shape[1] * width, step):
        v, u = place // width, place % width
        for channel in range(3):
            kept_rgb[i, v, u, channel] = rgb[i, v, u, channel]
        kept_segmentation[i, v, u] = segmentation[i, v, u]
