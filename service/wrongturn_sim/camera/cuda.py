"""Pictures of many egos at once, made on a GPU and kept there."""

import warnings
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol.installing import install
from wrongturn_sim.camera import cuda_kernels as kernels
from wrongturn_sim.camera.kernels import HITS, ROWS, WORK
from wrongturn_sim.camera.noise import clouds
from wrongturn_sim.camera.pinhole import Camera, one_size
from wrongturn_sim.camera.renderer import OTHER, others_of_each
from wrongturn_sim.camera.solids import COLUMNS, shop_colours
from wrongturn_sim.camera.weathers import RAIN, SIZE
from wrongturn_sim.camera.world import World
from wrongturn_sim.errors import CameraError

device: Any = kernels.cuda

THREADS: Final = 64
"""Threads of a block. They paint neighbouring columns, whose work is much alike."""

_MORE: Final = 16
"""Room for road users grows by this many."""
_MANY: Final = 128
"""Blocks of the smallest grid that numba does not warn about."""


class DeviceImages:
    """An array of bytes on the GPU.

    Libraries that know ``__cuda_array_interface__`` share its memory without a copy: ``torch.as_tensor(images,
    device="cuda")``, ``cupy.asarray(images)``. All work is done on the default stream, which PyTorch uses too.
    ``numpy.asarray(images)`` copies the array to the host.
    """

    def __init__(self, array: Any, index: int | slice | None = None) -> None:
        self._whole = array
        self._index = index

    @property
    def _array(self) -> Any:
        # Only on demand: numba needs longer to make a view than the GPU needs for a picture.
        return self._whole if self._index is None else self._whole[self._index]

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        interface: dict[str, Any] = self._array.__cuda_array_interface__
        return interface

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return tuple(self._array.shape)

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def dtype(self) -> np.dtype[np.uint8]:
        """Type of the elements: always uint8."""
        return np.dtype(np.uint8)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int | slice) -> "DeviceImages":
        """Return one or some of the pictures, which share the memory."""
        return DeviceImages(self._array, index)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("the pictures are on the GPU; numpy cannot share them, only copy")
        host: NDArray[Any] = self._array.copy_to_host()
        return host if dtype is None else host.astype(dtype)

    def copy(self) -> "DeviceImages":
        """Return a copy on the GPU."""
        fresh = device.device_array(self.shape, np.uint8)
        fresh.copy_to_device(self._array)
        return DeviceImages(fresh)


class CudaRenderer:
    """A camera in a world, for many cars that do not see each other; each may have other road users.

    The pictures are those of :func:`~wrongturn_sim.camera.render_batch`, except for a few pixels on edges, because a
    GPU rounds differently: on an H200, at most 4 pixels in a million have another class and 55 in a million a colour
    that differs by more than 1. The constructor allocates all memory, but for that of road users, which grows.

    ``number`` is the most pictures that one call makes. ``camera`` is that of all, or a list with that of each place;
    all of them make pictures of one size. Raises CameraError if a number is not what it should be, or there is no GPU.
    """

    def __init__(self, world: World, camera: Camera | Sequence[Camera], number: int) -> None:
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
            raise CameraError(f"number is {number!r}; give a whole number of pictures, 1 or more")
        if not device.is_available():
            raise CameraError(
                "backend: 'cuda' finds no GPU; it needs an NVIDIA GPU, its driver and "
                f"{install('numba-cuda[cu13]')} (or [cu12], as the driver is), or give backend='cpu'"
            )
        cameras = [camera] * number if isinstance(camera, Camera) else list(camera)
        self._camera = camera = one_size(cameras, number)
        self._number = number
        self._looks: NDArray[np.float64] | None = None
        self._looks_there: Any = None
        self._numbers = device.pinned_array((number, kernels.NUMBERS), np.float64)
        self._numbers_there = device.device_array((number, kernels.NUMBERS), np.float64)
        self._packed = device.to_device(np.array([one.packed() for one in cameras]))
        height, width = camera.height, camera.width
        self._items = len(world.scenery)
        # A GPU has no empty arrays.
        items = max(self._items, 1)
        scenery = world.scenery if self._items else np.zeros((1, COLUMNS))
        # Copies, because numba compiles another kernel for an array that is read-only.
        scene = (world.ground, world.frame, scenery, shop_colours(), clouds())
        self._scene = tuple(device.to_device(array.copy()) for array in scene)
        self._rows = device.device_array((number, ROWS, height), np.float64)
        self._counts = device.device_array((number, width), np.int32)
        self._canvas = device.device_array((number, height, width), np.uint32)
        self._scenery_rows = items
        self._make_room(1)
        low = max(height, HITS) <= kernels.LOW
        self._work = () if low else (device.device_array((number, WORK, max(height, HITS), width), np.float64),)
        self._paint = kernels.paint_low if low else kernels.paint_tall
        self._images = (
            device.device_array((number, height, width, 3), np.uint8),
            device.device_array((number, height, width), np.uint8),
        )
        self.rgb = DeviceImages(self._images[0])
        """(number, height, width, 3); the next call of :meth:`render` overwrites it."""
        self.segmentation = DeviceImages(self._images[1])
        """(number, height, width); the next call of :meth:`render` overwrites it."""
        self._kept: tuple[Any, Any] | None = None

    def render(
        self,
        looks: NDArray[np.float64],
        seeds: NDArray[np.integer[Any]],
        poses: NDArray[np.float64],
        ticks: NDArray[np.integer[Any]],
        *,
        kinds: NDArray[np.integer[Any]] | None = None,
        targets: NDArray[np.integer[Any]] | None = None,
        others: NDArray[np.float64] | None = None,
        begins: NDArray[np.integer[Any]] | None = None,
    ) -> None:
        """Paint the pictures of N cars.

        The call returns before the GPU has finished. Code that reads the pictures waits for them. The arguments are
        those of :func:`~wrongturn_sim.camera.render_batch`, but for two. ``kinds`` (N,) is the row of ``looks`` for
        each car, by default row i for car i; the table of looks is sent to the GPU only if it is another object than at
        the last call. ``targets`` (N,) are the places of the pictures, all different; the first N by default. Raises
        CameraError if an array has another shape, or a number is not finite or out of its range.
        """
        count = len(poses)
        if not 1 <= count <= self._number:
            raise CameraError(f"poses: {count} of them; give 1 to {self._number}")
        looks_kept = np.asarray(looks, np.float64)
        if looks_kept.ndim != 2 or looks_kept.shape[1] != SIZE or (kinds is None and len(looks_kept) != count):
            raise CameraError(f"looks have the shape {looks_kept.shape}; give ({count}, {SIZE}): a row of look_of each")
        chosen = np.arange(count) if kinds is None else np.asarray(kinds)
        places = np.arange(count) if targets is None else np.asarray(targets)
        for name, given, below in (("kinds", chosen, len(looks_kept)), ("targets", places, self._number)):
            if given.shape != (count,) or given.min() < 0 or given.max() >= below:
                raise CameraError(f"{name}: give {count} whole numbers from 0 to {below - 1}")
        numbers = self._numbers[:count]
        poses = np.asarray(poses, np.float64)
        if poses.shape != (count, 3) or not (np.abs(poses) < 1e7).all():
            raise CameraError(f"poses: give ({count}, 3) finite numbers below 1e7 in size: x, y, yaw")
        if len(seeds) != count or len(ticks) != count:
            raise CameraError(f"seeds and ticks: give {count} of each, as many as poses")
        numbers[:, : kernels.SEED] = poses
        numbers[:, kernels.SEED] = np.asarray(seeds) & 0x3FFFFFFF
        numbers[:, kernels.TICK] = ticks
        numbers[:, kernels.LOOK] = chosen
        numbers[:, kernels.TARGET] = places
        self._take_others(others, begins, numbers)
        if kinds is None or looks is not self._looks:
            self._looks_there = device.to_device(np.array(looks_kept, order="C"))
            self._looks = looks
        rain = bool((looks_kept[chosen, RAIN] > 0.0).any())
        if count >= _MANY:
            self._launch(count, rain=rain)
            return
        with warnings.catch_warnings():
            # Numba warns about small grids, which a few egos that start a new trial need.
            warnings.filterwarnings("ignore", "Grid size")
            self._launch(count, rain=rain)

    def _make_room(self, most: int) -> None:
        """Allocate what depends on the greatest number of road users that a picture can have."""
        number, items = self._number, self._scenery_rows + most
        self._most = most
        self._others = device.pinned_array((number * most, OTHER), np.float64)
        self._others_there = device.device_array((number * most, OTHER), np.float64)
        self._users = device.device_array((number, most, COLUMNS), np.float64)
        self._place = device.device_array((number, items, 2), np.float64)
        self._spans = device.to_device(np.zeros((number, items, 2), np.int16))
        self._lists = device.device_array((number, items, self._camera.width), np.int16)

    def _take_others(
        self, others: NDArray[np.float64] | None, begins: NDArray[np.integer[Any]] | None, numbers: NDArray[np.float64]
    ) -> None:
        """Send the road users to the GPU, and note which are whose."""
        shown, begun, most = others_of_each(others, begins, len(numbers))
        if most > self._most:
            self._make_room(-(-most // _MORE) * _MORE)
        numbers[:, kernels.BEGIN] = begun[:-1]
        numbers[:, kernels.OTHERS] = np.diff(begun)
        if len(shown):
            self._others[: len(shown)] = shown
            self._others_there[: len(shown)].copy_to_device(self._others[: len(shown)])

    def _launch(self, count: int, *, rain: bool) -> None:
        sent = self._numbers_there[:count]
        sent.copy_to_device(self._numbers[:count])
        camera = self._camera
        kernels.look_around[count, 2 * THREADS](
            sent, self._looks_there, self._packed, self._scene[2], self._items, self._others_there, camera.width,
            camera.height, self._rows, self._place, self._spans, self._users,
        )  # fmt: skip
        columns = (count, -(-camera.width // THREADS))
        self._paint[columns, THREADS](
            sent, self._looks_there, self._packed, *self._scene, self._rows, self._place, self._spans, self._counts,
            self._lists, self._users, self._canvas, *self._work, *self._images,
        )  # fmt: skip
        if rain:
            kernels.rain_down[columns, THREADS](sent, self._looks_there, self._images[0])

    def keep(self, which: NDArray[np.integer[Any]]) -> tuple[DeviceImages, DeviceImages]:
        """Copy the pictures of ``which`` (K,), all different, to other arrays, until the same places are copied again.

        Returns:
            RGB and segmentation of all places; those of ``which`` are up to date.
        """
        if self._kept is None:
            rgb, segmentation = (device.device_array(image.shape, np.uint8) for image in self._images)
            self._kept = rgb, segmentation
        chosen = device.to_device(np.array(which, np.int64))
        kernels.keep[(len(chosen), _MANY), 2 * THREADS](chosen, *self._images, *self._kept)
        return DeviceImages(self._kept[0]), DeviceImages(self._kept[1])
