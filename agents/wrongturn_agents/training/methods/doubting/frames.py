"""Pictures of places in many towns, rendered afresh for each minibatch."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.methods.places import Places, draw_places
from wrongturn_networks import Town, load_town, read_town
from wrongturn_protocol import TRAINING_WEATHERS, Weather
from wrongturn_sim.camera import Camera, World, look_of, render_batch

CHUNK: Final = 64
"""Pictures of one town in a minibatch."""
TRAINING_TOWN: Final = "Town01"
_TICKS: Final = 600
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
    """Draws places and renders them.

    Args:
        towns: towns of the places. The first is :data:`TRAINING_TOWN` or stands alone.
        seed: seed of places, weathers and rain.
        first_share: share of the chunks that show the first town; the others are shared equally.
        weathers: weathers, drawn equally often.
        device: device of the minibatches. On CUDA the pictures are rendered there too.
    """

    def __init__(
        self,
        towns: Sequence[Town],
        seed: int,
        *,
        first_share: float = 0.3,
        weathers: Sequence[Weather] = TRAINING_WEATHERS,
        device: torch.device | str = "cpu",
        threads: int = 1,
    ) -> None:
        self._towns = tuple(towns)
        self._random = np.random.default_rng(seed)
        others = len(self._towns) - 1
        self._shares = np.array([first_share if others else 1.0, *[(1 - first_share) / max(others, 1)] * others])
        self._looks = np.array([look_of(weather) for weather in weathers])
        self._device = torch.device(device)
        self._threads = threads
        self._camera = Camera()
        self._renderers: dict[str, Any] = {}

    def draw(self, count: int) -> Frames:
        """Return a minibatch of new pictures; ``count`` is rounded up to whole chunks."""
        chunks = [self._chunk(self._towns[k]) for k in
                  self._random.choice(len(self._towns), -(-count // CHUNK), p=self._shares).tolist()]  # fmt: skip
        places = [place for place, _ in chunks]
        pictures = [seen for _, seen in chunks]

        def truth(arrays: Sequence[Any]) -> Tensor:
            return torch.from_numpy(np.concatenate(arrays).astype(np.float32)).to(self._device)

        return Frames(
            {key: torch.cat([seen[key] for seen in pictures]) for key in ("rgb", "segmentation")},
            truth([place.distance for place in places]),
            truth([place.exits for place in places]),
            truth([place.shown for place in places]),
        )

    def _chunk(self, town: Town) -> tuple[Places, dict[str, Tensor]]:
        random = self._random
        places = draw_places(town, random, CHUNK)
        kinds = random.integers(len(self._looks), size=CHUNK)
        seeds, ticks = random.integers(_SEEDS, size=CHUNK), random.integers(_TICKS, size=CHUNK)
        return places, self.render(town, places, kinds, seeds, ticks)

    def render(self, town: Town, places: Places, kinds: Any, seeds: Any, ticks: Any) -> dict[str, Tensor]:
        """Return pictures of places, at most a chunk, with a row of the weathers for each."""
        count = len(places.poses)
        if self._device.type == "cuda":
            renderer = self._renderer(town)
            renderer.render(self._looks, seeds, places.poses, ticks, kinds=kinds)
            return {
                name: torch.as_tensor(images, device=self._device)[:count].clone()
                for name, images in (("rgb", renderer.rgb), ("segmentation", renderer.segmentation))
            }
        shape = count, self._camera.height, self._camera.width
        rgb, segmentation = np.empty((*shape, 3), np.uint8), np.empty(shape, np.uint8)
        looks = self._looks[kinds]
        render_batch(
            World.of(town), self._camera, looks, seeds, places.poses, ticks, rgb, segmentation, threads=self._threads
        )
        return {"rgb": torch.from_numpy(rgb), "segmentation": torch.from_numpy(segmentation)}

    def _renderer(self, town: Town) -> Any:
        known = self._renderers.get(town.name)
        if known is None:
            from wrongturn_sim.camera.cuda import CudaRenderer  # noqa: PLC0415 - only needed with a GPU

            known = self._renderers[town.name] = CudaRenderer(World.of(town), self._camera, CHUNK)
        return known


def towns_of(folder: Path, seeds: Sequence[int]) -> list[Town]:
    """Return generated towns, building those that are missing in the folder."""
    from wrongturn_networks.making.generated import generated_recipe  # noqa: PLC0415 - only training needs it
    from wrongturn_networks.making.netconvert import build  # noqa: PLC0415

    towns = []
    for seed in seeds:
        recipe = generated_recipe(seed)
        if not (folder / recipe.name / "manifest.json").is_file():
            try:
                build(recipe, folder / recipe.name)
            except (RuntimeError, OSError) as error:
                raise TrainingError(f"towns: {folder / recipe.name} cannot be built: {error}") from error
        towns.append(read_town(folder / recipe.name))
    return towns


def training_towns(folder: Path, number: int) -> list[Town]:
    """Return the training town and a number of generated ones."""
    return [load_town(TRAINING_TOWN), *towns_of(folder, range(number))]
