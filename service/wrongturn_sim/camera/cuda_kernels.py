"""The ray caster on a GPU: the functions of :mod:`~wrongturn_sim.camera.raycast`, compiled by ``numba.cuda``.

A block of threads sets what the pixels of a picture's rows have in common and in which columns each solid may be seen;
then a thread paints each column; then, where it rains, a thread each lets the drops fall in a column, in their order.
Numba's simulator runs the same kernels without a GPU: ``NUMBA_ENABLE_CUDASIM=1 NUMBA_DISABLE_JIT=1``.
"""

from typing import Any, Final

import numpy as np

if not hasattr(np, "row_stack"):
    # Gone from NumPy 2.5, and yet numba-cuda asks for it.
    setattr(np, "row_stack", np.vstack)  # noqa: B010

import numba.cuda

from wrongturn_sim.camera.backdrop import set_row
from wrongturn_sim.camera.kernels import WORK, Scene, Scratch, eye_of, kernel
from wrongturn_sim.camera.raycast import column_into, rain, show
from wrongturn_sim.camera.sight import span_of

# It warns of each launch for a few pictures, such as of those whose drives begin anew; there is nothing to be done.
setattr(numba.config, "CUDA_LOW_OCCUPANCY_WARNINGS", 0)  # noqa: B010 - numba makes its settings as it is loaded

LOW: Final = 64
"""Rows of the pictures whose columns fit a thread's own memory, which is the faster one."""

# Columns of the numbers of a picture: the pose, what rain is drawn from, which look, and where the picture goes.
PX, PY, YAW, SEED, TICK, LOOK, TARGET = range(7)
NUMBERS: Final = 7

cuda: Any = numba.cuda
"""As numba's simulator wants it: under this name, in this module."""

_LOCAL: Final = (WORK, LOW)


@cuda.jit(fastmath=True)
def look_around(
    numbers: Any,
    looks: Any,
    camera: Any,
    scenery: Any,
    items: int,
    width: int,
    height: int,
    rows: Any,
    place: Any,
    spans: Any,
) -> None:
    """Sets rows and spans; a block for each picture.

    ``rows`` (N, ROWS, height); ``place`` (N, items, 2); ``spans`` (N, items, 2): each solid's columns, from and to.
    """
    i = cuda.blockIdx.x
    eye = eye_of(numbers[i, PX], numbers[i, PY], numbers[i, YAW], camera)
    for item in range(cuda.threadIdx.x, items, cuda.blockDim.x):
        begin, end = span_of(scenery[item], eye, camera, width, height, place[i, item])
        spans[i, item, 0] = begin
        spans[i, item, 1] = end
    look = looks[int(numbers[i, LOOK])]
    for v in range(cuda.threadIdx.x, height, cuda.blockDim.x):
        set_row(v, camera, look, rows[i])


@kernel
def paint_column(
    i: int,
    u: int,
    numbers: Any,
    looks: Any,
    camera: Any,
    scene: Scene,
    rows: Any,
    place: Any,
    spans: Any,
    counts: Any,
    lists: Any,
    users: Any,
    canvas: Any,
    work: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints column u of picture i; ``work`` is that column's own, the other arrays are of all pictures."""
    count = 0
    for item in range(spans.shape[1]):
        if spans[i, item, 0] <= u < spans[i, item, 1]:
            lists[i, count, u] = item
            count += 1
    counts[i, u] = count
    # Neighbours' lists side by side, for threads that read them at once.
    scratch = Scratch(rows[i], work, place[i], counts[i], lists[i].T, users, canvas[i])
    eye = eye_of(numbers[i, PX], numbers[i, PY], numbers[i, YAW], camera)
    column_into(u, eye, camera, looks[int(numbers[i, LOOK])], scene, scratch)
    target = int(numbers[i, TARGET])
    for v in range(segmentation.shape[1]):
        show(v, u, canvas[i], rgb[target], segmentation[target])


@cuda.jit(fastmath=True)
def paint_low(
    numbers: Any,
    looks: Any,
    camera: Any,
    ground: Any,
    frame: Any,
    scenery: Any,
    shops: Any,
    cover: Any,
    rows: Any,
    place: Any,
    spans: Any,
    counts: Any,
    lists: Any,
    users: Any,
    canvas: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints pictures of no more than LOW rows, a thread for each column."""
    i, u = cuda.blockIdx.x, cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    work = cuda.local.array(_LOCAL, np.float64)
    if u < segmentation.shape[2]:
        scene = Scene(ground, frame, scenery, shops, cover)
        paint_column(
            i, u, numbers, looks, camera, scene, rows, place, spans, counts, lists, users, canvas, work, rgb,
            segmentation,
        )  # fmt: skip


@cuda.jit(fastmath=True)
def paint_tall(
    numbers: Any,
    looks: Any,
    camera: Any,
    ground: Any,
    frame: Any,
    scenery: Any,
    shops: Any,
    cover: Any,
    rows: Any,
    place: Any,
    spans: Any,
    counts: Any,
    lists: Any,
    users: Any,
    canvas: Any,
    work: Any,
    rgb: Any,
    segmentation: Any,
) -> None:
    """Paints pictures of any height, a thread for each column; ``work`` (N, WORK, rows, columns)."""
    i, u = cuda.blockIdx.x, cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    if u < segmentation.shape[2]:
        scene = Scene(ground, frame, scenery, shops, cover)
        mine = work[i, :, :, u]
        paint_column(
            i, u, numbers, looks, camera, scene, rows, place, spans, counts, lists, users, canvas, mine, rgb,
            segmentation,
        )  # fmt: skip


@cuda.jit(fastmath=True)
def rain_down(numbers: Any, looks: Any, rgb: Any) -> None:
    """Rain over the pictures, a thread for each column."""
    i, u = cuda.blockIdx.x, cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x
    if u < rgb.shape[2]:
        look = looks[int(numbers[i, LOOK])]
        rain(u, u + 1, look, int(numbers[i, SEED]), int(numbers[i, TICK]), rgb[int(numbers[i, TARGET])])


@cuda.jit
def keep(which: Any, rgb: Any, segmentation: Any, kept_rgb: Any, kept_segmentation: Any) -> None:
    """Copies some pictures, a row of blocks for each."""
    i = int(which[cuda.blockIdx.x])
    width = segmentation.shape[2]
    first, step = cuda.blockIdx.y * cuda.blockDim.x + cuda.threadIdx.x, cuda.gridDim.y * cuda.blockDim.x
    for place in range(first, segmentation.shape[1] * width, step):
        v, u = place // width, place % width
        for channel in range(3):
            kept_rgb[i, v, u, channel] = rgb[i, v, u, channel]
        kept_segmentation[i, v, u] = segmentation[i, v, u]
