"""Pictures of places in many towns, rendered afresh for each minibatch, and how right a network is about them."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from wrongturn_agents.models.doubt import LINE, MARKS, Doubt
from wrongturn_agents.training.disturbances import noisy
from wrongturn_agents.training.methods.places import Places, draw_places
from wrongturn_networks import Town
from wrongturn_protocol import TRAINING_WEATHERS
from wrongturn_sim.camera import Camera, World, look_of, render_batch

CHUNK: Final = 64
"""Pictures of one town in a minibatch."""
_TICKS: Final = 600
_HELD_OUT_SEED: Final = 9_001
_NEAR: Final = (5.0, 16.0)
_SEEDS: Final = 2**30


class Frames(NamedTuple):
    """A minibatch: pictures and the truth about them, on the device."""

    observation: dict[str, Tensor]
    """``rgb`` (n, 64, 192, 3) and ``segmentation`` (n, 64, 192), uint8."""
    distance: Tensor
    """(n,) metres to the stop line."""
    exits: Tensor
    """(n, 3)"""
    shown: Tensor
    """(n,)"""


class FrameSource:
    """Draws places and renders them, in the training weathers equally often.

    A share of the chunks shows the first town; the others are shared equally. On CUDA the pictures are rendered on the
    device of the minibatches. ``cameras`` are those of a chunk's pictures, the benchmark's by default, and ``noise`` is
    the greatest standard deviation of a picture's noise.
    """

    def __init__(
        self,
        towns: Sequence[Town],
        seed: int,
        *,
        first_share: float,
        device: torch.device,
        threads: int,
        cameras: Sequence[Camera] = (),
        noise: float = 0.0,
    ) -> None:
        self._towns = tuple(towns)
        self._random = np.random.default_rng(seed)
        others = len(self._towns) - 1
        self._shares = np.array([first_share if others else 1.0, *[(1 - first_share) / max(others, 1)] * others])
        self._looks = np.array([look_of(weather) for weather in TRAINING_WEATHERS])
        self._device, self._threads = device, threads
        self.cameras = list(cameras) or [Camera()] * CHUNK
        self.noise = noise
        self._renderers: dict[str, Any] = {}

    def draw(self, count: int) -> Frames:
        """Return a minibatch of new pictures; ``count`` is rounded up to whole chunks."""
        numbers = self._random.choice(len(self._towns), -(-count // CHUNK), p=self._shares).tolist()
        places, pictures = zip(*(self._chunk(self._towns[number]) for number in numbers), strict=True)

        def truth(name: str) -> Tensor:
            arrays = [getattr(place, name) for place in places]
            return torch.from_numpy(np.concatenate(arrays).astype(np.float32)).to(self._device)

        observation = {key: torch.cat([seen[key] for seen in pictures]) for key in ("rgb", "segmentation")}
        if self.noise:
            strengths = self._random.uniform(0.0, self.noise, len(observation["rgb"]))
            observation["rgb"] = noisy(observation["rgb"], torch.from_numpy(strengths))
        return Frames(observation, truth("distance"), truth("exits"), truth("shown"))

    def _chunk(self, town: Town) -> tuple[Places, dict[str, Tensor]]:
        random = self._random
        places = draw_places(town, random, CHUNK)
        kinds = random.integers(len(self._looks), size=CHUNK)
        seeds, ticks = random.integers(_SEEDS, size=CHUNK), random.integers(_TICKS, size=CHUNK)
        if self._device.type == "cuda":
            renderer = self._renderer(town)
            renderer.render(self._looks, seeds, places.poses, ticks, kinds=kinds)
            shown = {"rgb": renderer.rgb, "segmentation": renderer.segmentation}
            return places, {name: torch.as_tensor(one, device=self._device).clone() for name, one in shown.items()}
        shape = CHUNK, self.cameras[0].height, self.cameras[0].width
        rgb, segmentation = np.empty((*shape, 3), np.uint8), np.empty(shape, np.uint8)
        looks, world = self._looks[kinds], World.of(town)
        for camera in dict.fromkeys(self.cameras):
            rows = np.array([i for i in range(CHUNK) if self.cameras[i] == camera])
            seen, classes = np.empty((len(rows), *shape[1:], 3), np.uint8), np.empty((len(rows), *shape[1:]), np.uint8)
            render_batch(
                world, camera, looks[rows], seeds[rows], places.poses[rows], ticks[rows], seen, classes,
                threads=self._threads,
            )  # fmt: skip
            rgb[rows], segmentation[rows] = seen, classes
        return places, {"rgb": torch.from_numpy(rgb), "segmentation": torch.from_numpy(segmentation)}

    def _renderer(self, town: Town) -> Any:
        if town.name not in self._renderers:
            from wrongturn_sim.camera.cuda import CudaRenderer  # noqa: PLC0415 - only needed with a GPU

            self._renderers[town.name] = CudaRenderer(World.of(town), self.cameras, CHUNK)
        return self._renderers[town.name]


@torch.inference_mode()
def examine(
    model: Doubt,
    towns: Sequence[Town],
    *,
    pictures: int = 4096,
    threads: int = 1,
    cameras: Sequence[Camera] = (),
    noise: float = 0.0,
) -> dict[str, float]:
    """Return how right a network is about pictures of some towns, drawn equally often. RGB is not augmented.

    Returns:
        exits: share of right exits from 5 to 16 m before stop lines.
        approaches: share of pictures there with all three exits right.
        distance: mean error of the distance there, metres.
        inside: share of pictures that are rightly told to be nearer or farther than 2 m from the stop line.
    """
    device = next(model.parameters()).device
    share = 1.0 / len(towns)
    source = FrameSource(
        towns, _HELD_OUT_SEED, first_share=share, device=device, threads=threads, cameras=cameras, noise=noise
    )
    right, whole, error, near, sided, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    while total < pictures:
        frames = source.draw(min(512, pictures))
        exits, distance = (part.float() for part in model.tell(frames.observation))
        at = (frames.distance > _NEAR[0]) & (frames.distance <= _NEAR[1])
        same = ((exits > 0) == (frames.exits > 0.5))[at]
        right += same.float().mean(1).sum().item()
        whole += same.all(1).float().sum().item()
        error += (distance[:, 0] - frames.distance).abs()[at].sum().item()
        near += at.float().sum().item()
        sided += ((distance[:, 0] > 2.0) == (frames.distance > 2.0)).float().sum().item()
        total += len(frames.distance)
    return {"exits": right / near, "approaches": whole / near, "distance": error / near, "inside": sided / total}


@torch.inference_mode()
def temperatures(
    model: Doubt, towns: Sequence[Town], like: FrameSource, *, pictures: int = 4096, threads: int = 1
) -> dict[str, float]:
    """Return the temperatures that calibrate what a network tells, on disturbed pictures of some towns.

    Logits divided by them have the least cross-entropy (C. Guo et al., "On Calibration of Modern Neural Networks",
    2017). Cameras and noise are those of another source.

    Returns:
        exits: of the exits that are to be told.
        line: of "farther than :data:`LINE`".
    """
    device = next(model.parameters()).device
    source = FrameSource(
        towns, _HELD_OUT_SEED + 1, first_share=1.0 / len(towns), device=device, threads=threads, cameras=like.cameras,
        noise=like.noise,
    )  # fmt: skip
    found: dict[str, list[tuple[Tensor, Tensor]]] = {"exits": [], "line": []}
    for _ in range(-(-pictures // 512)):
        frames = source.draw(512)
        exits, beyond = (part.float() for part in model(model.disturb(frames.observation)))
        shown = frames.shown > 0.5
        found["exits"].append((exits[shown].flatten(), frames.exits[shown].flatten()))
        found["line"].append((beyond[:, MARKS.index(LINE)], (frames.distance > LINE).float()))
    return {name: _temperature(*map(torch.cat, zip(*pairs, strict=True))) for name, pairs in found.items()}


def _temperature(logits: Tensor, truth: Tensor) -> float:
    """Return the temperature from 0.25 to 4 with the least cross-entropy."""
    tried = torch.logspace(-2.0, 2.0, 201, 2.0).tolist()
    losses = [functional.binary_cross_entropy_with_logits(logits / one, truth).item() for one in tried]
    return round(float(tried[int(np.argmin(losses))]), 3)
