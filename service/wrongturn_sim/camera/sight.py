"""Who may be seen in which column."""

from typing import Any, Final

from wrongturn_sim.camera.kernels import Scratch, ceil, clamp, floor, kernel
from wrongturn_sim.camera.pinhole import CX, CY, FOCAL, PITCH_COS, PITCH_SIN
from wrongturn_sim.camera.solids import BOUND, COS, FENCE, HALF_X, HALF_Y, HOUSE, KIND, SIN, TREE, X, Y

FAR: Final = 420.0
FAR_TREES: Final = 240.0
FAR_LOW: Final = 160.0
"""Houses, trees, and what is lower are not drawn beyond, metres."""


@kernel
def span_of(
    row: Any, px: float, py: float, fx: float, fy: float, camera: Any, width: int, height: int, place: Any
) -> tuple[int, int]:
    """The columns in which a solid may be seen, from and to; notes the camera's place in the solid's own frame."""
    ox, oy = row[X] - px, row[Y] - py
    ahead, aside, bound = ox * fx + oy * fy, oy * fx - ox * fy, row[BOUND]
    far = FAR if row[KIND] == HOUSE else FAR_TREES if row[KIND] == TREE else FAR_LOW
    if ahead > far:
        return 0, 0
    begin, end = 0, width
    tilt_cos, tilt_sin, focal, cx = camera[PITCH_COS], camera[PITCH_SIN], camera[FOCAL], camera[CX]
    # How far ahead a ray goes on the flat for each metre of depth, at the upper and lower edge.
    upper = tilt_cos + camera[CY] / focal * tilt_sin
    lower = tilt_cos - (height - 1 - camera[CY]) / focal * tilt_sin
    least, most = min(upper, lower), max(upper, lower)
    # Who looks down, or up, steeply enough sees what is behind too.
    if ahead < -bound and least > 0.0:
        return 0, 0
    place[0] = -(row[COS] * ox + row[SIN] * oy)
    place[1] = -(row[COS] * oy - row[SIN] * ox)
    if ahead - bound > 0.5 and least > 0.1:
        if row[KIND] == TREE or row[KIND] > FENCE:
            left = (aside + bound) / (ahead - bound if aside > -bound else ahead + bound)
            right = (aside - bound) / (ahead + bound if aside > bound else ahead - bound)
        else:
            # The corners of a box are the outermost that is seen of it.
            left, right = -1e9, 1e9
            cos, sin = row[COS] * fx + row[SIN] * fy, row[SIN] * fx - row[COS] * fy
            for corner in range(4):
                along = row[HALF_X] if corner & 1 else -row[HALF_X]
                across = row[HALF_Y] if corner & 2 else -row[HALF_Y]
                seen = (aside + along * sin + across * cos) / (ahead + along * cos - across * sin)
                left, right = max(left, seen), min(right, seen)
        left *= most if left > 0.0 else least
        right *= least if right > 0.0 else most
        begin = int(clamp(floor(cx - focal * left), 0.0, width * 1.0))
        end = int(clamp(ceil(cx - focal * right) + 1.0, 0.0, width * 1.0))
    return begin, end


@kernel
def in_sight(
    item: int,
    row: Any,
    px: float,
    py: float,
    fx: float,
    fy: float,
    camera: Any,
    width: int,
    height: int,
    scratch: Scratch,
) -> None:
    """Notes a solid in the lists of the columns in which it may be seen."""
    begin, end = span_of(row, px, py, fx, fy, camera, width, height, scratch.place[item])
    counts, lists = scratch.counts, scratch.lists
    for u in range(begin, end):
        lists[u, counts[u]] = item
        counts[u] += 1
