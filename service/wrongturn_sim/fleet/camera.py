"""Pictures of a fleet: one batch for each decision."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from wrongturn_protocol import Track, Trial, Weather
from wrongturn_protocol.observations import Observation
from wrongturn_sim.camera import Camera, CameraError, WeatherLook, World, look_of, render_batch
from wrongturn_sim.camera.weathers import pack
from wrongturn_sim.fleet.fleet import Fleet

if TYPE_CHECKING:
    from wrongturn_sim.camera.cuda import CudaRenderer

_KINDS: Final = {weather: kind for kind, weather in enumerate(Weather)}


class FleetCamera:
    """Renders what each ego of a fleet sees.

    The benchmark's camera is the default, the track ``camera`` or ``segmentation``. The bytes do not depend on the
    number of threads. With the backend ``cuda`` the pictures are rendered on a GPU and stay there, as
    :class:`~wrongturn_sim.camera.cuda.DeviceImages`. A trial shows its weather's look or, if there are ``looks``,
    the one that its seed chooses. Raises CameraError if there is no GPU.
    """

    def __init__(
        self,
        fleet: Fleet,
        camera: Camera | Sequence[Camera] | None,
        track: Track,
        threads: int,
        backend: str = "cpu",
        looks: Sequence[WeatherLook] = (),
    ) -> None:
        self._fleet = fleet
        self._cameras: list[Camera] = [camera] if isinstance(camera, Camera) else list(camera or [Camera()])
        camera = self._cameras[0]
        self._threads = threads
        self._world = World.of(fleet.town)
        self._looks = len(looks)
        self._table = np.array([pack(look) for look in looks] or [look_of(weather) for weather in Weather])
        self._rendered: list[Trial | None] = [None] * fleet.count
        self._kinds = np.zeros(fleet.count, np.int64)
        self._seeds = np.zeros(fleet.count, np.int64)
        self._gpu = self._on_gpu() if backend == "cuda" else None
        shape = (fleet.count, camera.height, camera.width)
        gpu: Any = self._gpu
        self._rgb: Any = np.zeros((*shape, 3), np.uint8) if gpu is None else gpu.rgb
        self._segmentation: Any = np.zeros(shape, np.uint8) if gpu is None else gpu.segmentation
        self.pictures: Observation = {"rgb": self._rgb}
        """(n, height, width, 3) and, in the segmentation track, (n, height, width); each rendering overwrites them."""
        if track is Track.SEGMENTATION:
            self.pictures["segmentation"] = self._segmentation

    def render(self, which: Sequence[int] | None = None) -> None:
        """Render what all egos see, or only some; each has begun a trial."""
        fleet = self._fleet
        chosen = np.arange(fleet.count) if which is None else np.array(which, np.int64)
        if not len(chosen):
            return
        for i in chosen.tolist():
            trial = fleet.trials[i]
            if trial is not None and trial is not self._rendered[i]:
                self._rendered[i] = trial
                self._kinds[i] = trial.seed % self._looks if self._looks else _KINDS[trial.weather]
                self._seeds[i] = trial.seed & 0x3FFFFFFF
        kinds, seeds, poses, ticks = self._kinds[chosen], self._seeds[chosen], fleet.poses[chosen], fleet.steps[chosen]
        others, begins = fleet.others(chosen)
        if self._gpu is not None:
            self._gpu.render(
                self._table, seeds, poses, ticks, kinds=kinds, targets=chosen, others=others, begins=begins
            )
            return
        whole = len(chosen) == fleet.count
        rgb = self._rgb if whole else np.empty((len(chosen), *self._rgb.shape[1:]), np.uint8)
        segmentation = self._segmentation if whole else np.empty((len(chosen), *rgb.shape[1:3]), np.uint8)
        looks = self._table[kinds]
        if len(self._cameras) == 1:
            render_batch(
                self._world, self._cameras[0], looks, seeds, poses, ticks, rgb, segmentation, threads=self._threads,
                others=others, begins=begins,
            )  # fmt: skip
        else:
            for k, i in enumerate(chosen.tolist()):
                one = slice(k, k + 1)
                render_batch(
                    self._world, self._cameras[i], looks[one], seeds[one], poses[one], ticks[one], rgb[one],
                    segmentation[one], others=others[begins[k] : begins[k + 1]], begins=begins[k : k + 2] - begins[k],
                )  # fmt: skip
        if not whole:
            self._rgb[chosen] = rgb
            self._segmentation[chosen] = segmentation

    def last(self, which: Sequence[int]) -> list[Observation]:
        """Return copies of some egos' pictures; on a GPU, a copy lasts until the same ego's next one."""
        if self._gpu is None:
            return [{name: array[i].copy() for name, array in self.pictures.items()} for i in which]
        kept: dict[str, Any] = dict(zip(("rgb", "segmentation"), self._gpu.keep(np.array(which)), strict=True))
        return [{name: kept[name][i] for name in self.pictures} for i in which]

    def _on_gpu(self) -> "CudaRenderer":
        try:
            from wrongturn_sim.camera.cuda import CudaRenderer  # noqa: PLC0415 - only needed with a GPU
        except ImportError as error:
            raise CameraError(f"backend: 'cuda' needs numba-cuda: {error}; install it, or give backend='cpu'") from None
        cameras = self._cameras
        return CudaRenderer(self._world, cameras if len(cameras) > 1 else cameras[0], self._fleet.count)
