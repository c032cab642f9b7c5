"""Which solids may be seen in which columns."""

from typing import Any, Final

from wrongturn_sim.camera.kernels import Eye, Scratch, ceil, clamp, floor, kernel
from wrongturn_sim.camera.pinhole import CX, CY, FOCAL, PITCH_COS, PITCH_SIN
from wrongturn_sim.camera.solids import BOUND, COS, FENCE, HALF_X, HALF_Y, HOUSE, KIND, SIN, TREE, X, Y

FAR: Final = 420.0
"""Houses farther away than this are not drawn, metres."""
FAR_TREES: Final = 240.0
"""The same for trees."""
FAR_LOW: Final = 160.0
"""The same for all that is lower."""


@kernel
def span_of(row: Any, eye: Eye, camera: Any, width: int, height: int, place: Any) -> tuple[int, int]:
    """Return the first column in which a solid may be seen, and the one after the last.

    Writes the camera's place in the solid's own frame to ``place``.
    """
    ox, oy = row[X] - eye.x, row[Y] - eye.y
    ahead = ox * eye.ahead_x + oy * eye.ahead_y
    aside = oy * eye.ahead_x - ox * eye.ahead_y
    bound = row[BOUND]
    far = FAR if row[KIND] == HOUSE else FAR_TREES if row[KIND] == TREE else FAR_LOW
    if ahead > far:
        return 0, 0
    # How far a ray goes on the flat for each metre of depth, at the upper and the lower edge.
    focal, cy, tilt_cos, tilt_sin = camera[FOCAL], camera[CY], camera[PITCH_COS], camera[PITCH_SIN]
    upper = tilt_cos + cy / focal * tilt_sin
    lower = tilt_cos - (height - 1 - cy) / focal * tilt_sin
    least, most = min(upper, lower), max(upper, lower)
    # A camera that looks down or up steeply sees what is behind it too.
    if ahead < -bound and least > 0.0:
        return 0, 0
    place[0] = -(row[COS] * ox + row[SIN] * oy)
    place[1] = -(row[COS] * oy - row[SIN] * ox)
    if ahead - bound <= 0.5 or least <= 0.1:
        return 0, width
    left, right = edges_of(row, eye, ahead, aside)
    left *= most if left > 0.0 else least
    right *= least if right > 0.0 else most
    begin = int(clamp(floor(camera[CX] - focal * left), 0.0, width * 1.0))
    end = int(clamp(ceil(camera[CX] - focal * right) + 1.0, 0.0, width * 1.0))
    return begin, end


@kernel
def edges_of(row: Any, eye: Eye, ahead: float, aside: float) -> tuple[float, float]:
    """Return how far left of the camera's axis a solid's left and right edges are, for each metre ahead."""
    bound = row[BOUND]
    if row[KIND] == TREE or row[KIND] > FENCE:
        left = (aside + bound) / (ahead - bound if aside > -bound else ahead + bound)
        right = (aside - bound) / (ahead + bound if aside > bound else ahead - bound)
        return left, right
    # A box reaches from one corner to another.
    left, right = -1e9, 1e9
    cos = row[COS] * eye.ahead_x + row[SIN] * eye.ahead_y
    sin = row[SIN] * eye.ahead_x - row[COS] * eye.ahead_y
    for corner in range(4):
        along = row[HALF_X] if corner & 1 else -row[HALF_X]
        across = row[HALF_Y] if corner & 2 else -row[HALF_Y]
        seen = (aside + along * sin + across * cos) / (ahead + along * cos - across * sin)
        left, right = max(left, seen), min(right, seen)
    return left, right


@kernel
def in_sight(item: int, row: Any, eye: Eye, camera: Any, width: int, height: int, scratch: Scratch) -> None:
    """Add a solid to the lists of the columns in which it may be seen."""
    begin, end = span_of(row, eye, camera, width, height, scratch.place[item])
    counts, lists = scratch.counts, scratch.lists
    for u in range(begin, end):
        lists[u, counts[u]] = item
        counts[u] += 1
