"""Pictures of a world, one or many at a time, made on the CPU."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import Weather
from wrongturn_sim.camera.kernels import HITS, ROWS, WORK, Scene, Scratch
from wrongturn_sim.camera.noise import clouds
from wrongturn_sim.camera.pinhole import Camera
from wrongturn_sim.camera.raycast import pictures_into
from wrongturn_sim.camera.road_users import USER_COLOUR
from wrongturn_sim.camera.solids import COLUMNS, shop_colours
from wrongturn_sim.camera.weathers import SIZE, look_of
from wrongturn_sim.camera.world import World
from wrongturn_sim.errors import CameraError

Image = NDArray[np.uint8]
Numbers = NDArray[np.float64]

OTHER = USER_COLOUR + 1
"""Columns of a road user: x, y, yaw, length, width, height, kind (0 vehicle, 1 pedestrian), colour."""

_NOBODY = np.zeros((0, OTHER))
_paint: Any = pictures_into  # mypy does not count arguments in tuples


def _fixed(world: World, camera: Camera, others: int) -> tuple[Any, ...]:
    """Return what one thread's pictures have in common: camera, scene and arrays to paint with; room for ``others``."""
    items = max(len(world.scenery) + others, 1)
    scratch = Scratch(
        rows=np.zeros((ROWS, camera.height)),
        work=np.zeros((WORK, max(camera.height, HITS))),
        place=np.zeros((items, 2)),
        counts=np.zeros(camera.width, np.int64),
        # An odd number of cache lines for each column; else the lists of all columns would share a few cache lines.
        lists=np.zeros((camera.width, items // 32 * 32 + 48), np.int32),
        users=np.zeros((others, COLUMNS)),
        canvas=np.zeros((camera.height, camera.width), np.uint32),
    )
    return camera.packed(), *Scene(world.ground, world.frame, world.scenery, shop_colours(), clouds()), *scratch


class Renderer:
    """A camera in a world under one weather.

    Use one renderer for each thread: it reuses the arrays that it paints with. The camera is the benchmark's by
    default, the weather one of CARLA's presets, such as ``"WetNoon"``. ``seed`` is that of the rain; an episode takes
    its trial's. Raises UnknownWeatherError, and CameraError if the seed is not a whole number.
    """

    def __init__(
        self, world: World, camera: Camera | None = None, weather: Weather | str = Weather.CLEAR_NOON, seed: int = 0
    ) -> None:
        self.world = world
        self.camera = camera or Camera()
        # A copy, because numba compiles another kernel for an array that is read-only.
        self._look = look_of(weather)[None].copy()
        self._seeds = np.array([_folded(seed)], np.int64)
        self._pose = np.zeros((1, 3))
        self._ticks = np.zeros(1, np.int64)
        self._begins = np.zeros(2, np.int64)
        self._fixed, self._room = _fixed(world, self.camera, 0), 0

    def render(
        self, x: float, y: float, yaw: float, tick: int = 0, others: Numbers | None = None
    ) -> tuple[Image, Image]:
        """Return what a car at (x, y, yaw) sees, as new arrays.

        The place is that of the body's middle, metres, and the heading radians, counter-clockwise from east. ``tick``
        is the number of the decision; each has other raindrops. ``others`` (N, 8) are other road users: x, y, yaw,
        length, width, height, kind (0 vehicle, 1 pedestrian), colour.

        Returns:
            RGB, (height, width, 3) uint8, and segmentation, (height, width) uint8.

        Raises:
            CameraError: a number is not finite or an array has another shape.
        """
        if others is None or len(others) == 0:
            others = _NOBODY
        else:
            others = _checked_others(others)
            if len(others) > self._room:
                self._room = 2 * len(others)
                self._fixed = _fixed(self.world, self.camera, self._room)
        self._pose[0] = x, y, yaw
        _finite("pose", self._pose)
        self._ticks[0] = tick
        self._begins[1] = len(others)
        shape = 1, self.camera.height, self.camera.width
        rgb, segmentation = np.empty((*shape, 3), np.uint8), np.empty(shape, np.uint8)
        numbers = self._pose, self._seeds, self._ticks, others, self._begins, self._look
        _paint(*numbers, *self._fixed, rgb, segmentation)
        return rgb[0], segmentation[0]


def render_batch(
    world: World,
    camera: Camera,
    looks: Numbers,
    seeds: NDArray[np.integer[Any]],
    poses: Numbers,
    ticks: NDArray[np.integer[Any]],
    rgb: Image,
    segmentation: Image,
    threads: int = 1,
    others: Numbers | None = None,
    begins: NDArray[np.integer[Any]] | None = None,
) -> None:
    """Paint what each of many cars sees; the cars do not see each other, but each may have other road users.

    The bytes equal those of :meth:`Renderer.render`, with any number of ``threads``. ``looks`` (N, SIZE) are rows of
    :func:`look_of`, ``seeds`` (N,) those of the rain, ``poses`` (N, 3) x, y, yaw, ``ticks`` (N,) numbers of the
    decisions. ``rgb`` (N, height, width, 3) and ``segmentation`` (N, height, width), uint8, are written to. ``others``
    (M, 8) are other road users as for :meth:`Renderer.render`, those of the first car first, and ``begins`` (N + 1,)
    says where those of each car begin; None: nobody. Raises CameraError if an array has another shape or type, or a
    number is not finite.
    """
    number = len(poses)
    poses = np.array(poses, np.float64, order="C")
    looks = np.array(looks, np.float64, order="C")
    if poses.shape != (number, 3):
        raise CameraError(f"poses have the shape {poses.shape}; give (N, 3): x, y, yaw")
    if looks.shape != (number, SIZE):
        raise CameraError(f"looks have the shape {looks.shape}; give ({number}, {SIZE}): a row of look_of for each")
    if threads < 1:
        raise CameraError(f"threads is {threads}; give 1 or more")
    _finite("poses", poses)
    _check_images(camera, number, rgb, segmentation)
    folded = np.array([_folded(int(seed)) for seed in seeds], np.int64)
    counted = np.array(ticks, np.int64)
    if len(folded) != number or counted.shape != (number,):
        raise CameraError(f"seeds and ticks: give {number} of each, as many as poses")
    shown, begun, most = others_of_each(others, begins, number)

    def paint(part: slice) -> None:
        first, end = part.start, part.stop + 1
        numbers = poses[part], folded[part], counted[part], shown, begun[first:end], looks[part]
        _paint(*numbers, *_fixed(world, camera, most), rgb[part], segmentation[part])

    if threads == 1 or number < 2:
        paint(slice(0, number))
        return
    # Every thread runs the same compiled function. Another one, compiled for threads, might round differently.
    edges = np.linspace(0, number, min(threads, number) + 1).astype(int)
    with ThreadPoolExecutor(min(threads, number)) as pool:
        list(pool.map(paint, (slice(int(a), int(b)) for a, b in itertools.pairwise(edges))))


def _folded(seed: int) -> int:
    """Return a seed of any size as one that the kernels can add to without overflow."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer):
        raise CameraError(f"seed is {seed!r}; give a whole number")
    return int(seed) & 0x3FFFFFFF


def _finite(name: str, numbers: Numbers) -> None:
    # Beyond this, the number of a cell would not fit its type.
    if not (np.abs(numbers) < 1e7).all():
        raise CameraError(f"{name}: {numbers.tolist()}; give finite numbers, below 1e7 in size")


def _checked_others(others: Numbers) -> Numbers:
    others = np.array(others, np.float64, order="C")
    if others.ndim != 2 or others.shape[1] != OTHER:
        raise CameraError(f"others have the shape {others.shape}; give (N, {OTHER})")
    _finite("others", others)
    if (others[:, 3:6] <= 0).any():
        raise CameraError("others: length, width and height must be above 0")
    return others


def others_of_each(
    others: Numbers | None, begins: NDArray[np.integer[Any]] | None, number: int
) -> tuple[Numbers, NDArray[np.int64], int]:
    """Return the road users of many cars, where those of each begin, and the most that one car has."""
    if others is None or begins is None or len(others) == 0:
        return _NOBODY, np.zeros(number + 1, np.int64), 0
    shown, begun = _checked_others(others), np.array(begins, np.int64)
    counts = np.diff(begun)
    if begun.shape != (number + 1,) or begun[0] != 0 or begun[-1] != len(shown) or (counts < 0).any():
        raise CameraError(f"begins: give {number + 1} rising numbers from 0 to {len(shown)}, the number of others")
    return shown, begun, int(counts.max())


def _check_images(camera: Camera, number: int, rgb: Image, segmentation: Image) -> None:
    wanted = number, camera.height, camera.width
    for name, image, shape in (("rgb", rgb, (*wanted, 3)), ("segmentation", segmentation, wanted)):
        if image.dtype != np.uint8 or image.shape != shape or not image.flags.c_contiguous or not image.flags.writeable:
            raise CameraError(
                f"{name}: {image.dtype} of the shape {image.shape}; give a writable, contiguous uint8 array of {shape}"
            )
