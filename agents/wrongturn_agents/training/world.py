"""Where an agent learns: Town01, Town01 with drawn scenery, and towns of names that no draw gives; and how it sees."""

import contextlib
import itertools
import math
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from wrongturn_agents.training.cars import DrivingVecEnv, Observations, training_cars
from wrongturn_agents.training.disturbances import DisturbedCars
from wrongturn_agents.training.drives_config import CarsConfig, DrivesConfig, PlacesConfig, WorldConfig
from wrongturn_agents.training.errors import TrainingError
from wrongturn_networks import Town, load_town, read_town
from wrongturn_networks.drawn import make_town
from wrongturn_protocol import TRAINING_WEATHERS
from wrongturn_protocol.home import home
from wrongturn_sim import FleetTraffic
from wrongturn_sim.camera import LOOKS, Camera, WeatherLook

TRAINING_TOWN: Final = "Town01"
HELD_OUT: Final = range(1000, 1004)
"""Numbers of the towns in which agents are examined. None of them is learned from."""
MEETING: Final = FleetTraffic(crossers=0.5, waiters=0.5)
"""Traffic of held-out journeys, if the agent learns in drawn towns: an agent has to give way and to wait often."""
_JOURNEY_TOWNS: Final = 2
_PITCH, _UP, _FOCAL = 0.05, 0.2, 0.08
"""Greatest change of a camera's pitch, radians; height, metres; and focal length, as a share."""
_LOOKS_EACH: Final = 64
"""Number of looks of the weather in each place."""
_Config = TypeVar("_Config", bound=CarsConfig)
_Cars = TypeVar("_Cars")


def towns_of(numbers: Iterable[int]) -> list[Town]:
    """Return towns like those that secrets make, from the folder of towns. Those that are missing are built."""
    towns = []
    for number in numbers:
        folder = home() / "towns" / f"training-{number}"
        if not (folder / "manifest.json").is_file():
            try:
                folder.parent.mkdir(parents=True, exist_ok=True)
                with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as scratch:
                    made = Path(scratch) / folder.name
                    make_town(folder.name, made)
                    with contextlib.suppress(OSError):  # another run was faster
                        made.rename(folder)
            except (RuntimeError, OSError) as error:
                raise TrainingError(f"towns: {folder} cannot be built: {error}") from error
        towns.append(read_town(folder))
    return towns


def held_out_towns(settings: Any) -> list[Town]:
    """Return the drawn towns of held-out journeys; none for an agent that learns in Town01 alone."""
    return towns_of(HELD_OUT[:_JOURNEY_TOWNS]) if getattr(settings, "towns", 0) else []


def cars_of(settings: DrivesConfig, device: torch.device | str, **options: Any) -> VecEnv:
    """Return :func:`training_cars` in the towns and with the disturbances of the settings.

    They drive in Town01 alone if the settings name no others.
    """
    if not isinstance(settings, PlacesConfig):
        return training_cars(None, device, settings=settings, **options)
    if settings.towns + settings.sceneries:
        cars: VecEnv = CarsInTowns(settings, device, **options)
    else:
        cars = training_cars(None, device, settings=settings, **eyes_of(settings, settings.num_envs), **options)
    if isinstance(settings, WorldConfig) and (settings.noise or settings.delay or settings.steering):
        return DisturbedCars(cars, settings, options.get("seed"))
    return cars


def eyes_of(settings: PlacesConfig, count: int, *stream: int) -> dict[str, Any]:
    """Return the arguments ``camera`` and ``looks`` for ``count`` cars; ``stream`` numbers their place, if any."""
    return {
        "camera": mounts_of(count, *stream) if settings.cameras else None,
        "looks": looks_of(*stream) if settings.weathers else (),
    }


def looks_of(*stream: int) -> list[WeatherLook]:
    """Return looks between two training weathers each, at any share, from seeds of no draw.

    The two are drawn alike, so about a quarter of the looks are one weather's own.
    """
    random, known = np.random.default_rng([2**53 + 1, *stream]), [LOOKS[weather] for weather in TRAINING_WEATHERS]
    pairs, shares = random.integers(len(known), size=(_LOOKS_EACH, 2)).tolist(), random.random(_LOOKS_EACH).tolist()
    return [known[one].mixed(known[other], share) for (one, other), share in zip(pairs, shares, strict=True)]


def mounts_of(count: int, *stream: int, level: bool = False) -> list[Camera]:
    """Return cameras with other pitches, heights and focal lengths than the benchmark's, from seeds of no draw.

    If ``level``, the horizon is moved up or down instead of the camera pitched. Such pictures differ by 2 pixels in
    the corners at most, and on a CPU they take a tenth of the time.
    """
    usual, drawn = Camera(), np.random.default_rng([2**53, *stream]).uniform(-1.0, 1.0, (count, 3)).tolist()
    mounts = []
    for pitch, up, focal in drawn:
        mount = Camera(up=usual.up + _UP * up, focal=usual.focal * (1.0 + _FOCAL * focal))
        tilt = _PITCH * pitch
        mounts.append(
            replace(mount, cy=mount.cy - mount.focal * math.tan(tilt)) if level else replace(mount, pitch=tilt)
        )
    return mounts


class Groups(Generic[_Cars]):
    """Groups of cars, each in a town of its own.

    Again and again a group moves on to its next town. A town's cars are made when they first drive, and kept.

    Attributes:
        rows: the cars of each group, among all.
        made: the cars of each place that was visited.
    """

    def __init__(self, settings: PlacesConfig, make: Callable[[int, Town, int], _Cars]) -> None:
        """``make(place, town, count)`` makes so many cars in a town; ``place`` numbers the town and its scenery."""
        self._places = _places(settings)
        groups = min(settings.groups, len(self._places), settings.num_envs)
        edges = np.linspace(0, settings.num_envs, groups + 1).astype(int).tolist()
        self.rows = [slice(begin, end) for begin, end in itertools.pairwise(edges)]
        self.made: dict[int, _Cars] = {}
        self._make, self._stay = make, max(1, settings.stay // groups)
        self._driving = list(range(groups))
        self._steps = 0

    def cars(self, group: int) -> _Cars:
        """Return the cars of a group in its town."""
        place, rows = self._driving[group], self.rows[group]
        if place not in self.made:
            self.made[place] = self._make(place, self._places[place](), rows.stop - rows.start)
        return self.made[place]

    def all(self) -> list[_Cars]:
        """Return the cars of all groups."""
        return [self.cars(group) for group in range(len(self.rows))]

    def move(self) -> int | None:
        """Count a decision, and return the group that then moves on to its next town; None if none does."""
        self._steps += 1
        turn, left = divmod(self._steps, self._stay)
        if left or len(self.rows) == len(self._places):
            return None
        group = turn % len(self.rows)
        following = self._driving[group] + len(self.rows)
        self._driving[group] = following if following < len(self._places) else group
        return group


class CarsInTowns(VecEnvWrapper):
    """The cars of a learner that drives in many towns. When a group moves on, its drives end as at their time limit.

    ``settings`` are of :class:`DrivesConfig` and :class:`PlacesConfig` both.
    """

    def __init__(self, settings: Any, device: torch.device | str, *, seed: int | None = None, **options: Any) -> None:
        def make(place: int, town: Town, count: int) -> DrivingVecEnv:
            drawn = None if self._seed is None else np.random.SeedSequence([self._seed, place]).generate_state(1)[0]
            return training_cars(
                count, device, settings=with_fewer_road_users(settings, town), town=town,
                **eyes_of(settings, count, place), **options,
                seed=None if drawn is None else int(drawn),
            )  # fmt: skip

        self._seed = seed
        self._groups = Groups(settings, make)
        self._actions: NDArray[Any] | None = None
        super().__init__(self._groups.cars(0))
        self.num_envs = settings.num_envs

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the drives of towns that were not visited yet."""
        self._seed = seed
        return [seed] * self.num_envs

    def reset(self) -> Observations:
        """Start new drives."""
        return _joined([cars.reset() for cars in self._groups.all()])

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Drive on for 0.1 s; now and then a group moves on."""
        actions, self._actions = self._actions, None
        if actions is None:
            raise RuntimeError("step_wait: there are no actions; call step_async first, or step")
        found: list[Any] = [
            cars.step(actions[rows]) for cars, rows in zip(self._groups.all(), self._groups.rows, strict=True)
        ]
        if (group := self._groups.move()) is not None:
            seen, rewards, ended, infos = found[group]
            cut: list[dict[str, Any]] = [
                infos[i] or {
                    "verdict": "timeout",
                    "TimeLimit.truncated": True,
                    "terminal_observation": {key: seen[key][i] for key in seen},
                }
                for i in range(len(infos))
            ]  # fmt: skip
            found[group] = self._groups.cars(group).reset(), rewards, np.ones_like(ended), cut
        seen, rewards, ended, infos = zip(*found, strict=True)
        return _joined(seen), np.concatenate(rewards), np.concatenate(ended), [one for some in infos for one in some]

    @property
    def poses_by_town(self) -> list[tuple[Town, NDArray[np.float64]]]:
        """The town of each group, and where its cars are, as :attr:`DrivingVecEnv.poses_by_town`."""
        return [one for cars in self._groups.all() for one in cars.poses_by_town]

    def close(self) -> None:
        """Stop the threads."""
        for cars in self._groups.made.values():
            cars.close()


def with_fewer_road_users(settings: _Config, town: Town) -> _Config:
    """Return some settings with fewer road users, if a town is smaller than Town01: its streets are as full."""
    share = min(1.0, _metres(town) / _metres(load_town(TRAINING_TOWN)))
    return replace(settings, vehicles=round(settings.vehicles * share), pedestrians=round(settings.pedestrians * share))


def _places(settings: PlacesConfig) -> list[Callable[[], Town]]:
    """Return the towns of some settings, Town01 first and its sceneries evenly among the others."""
    here = load_town(TRAINING_TOWN)
    known: list[Callable[[], Town]] = [lambda: here]
    known += [partial(load_town, TRAINING_TOWN, number) for number in range(settings.sceneries)]
    places = [((number + 0.5) / len(known), town) for number, town in enumerate(known)]
    for number, town in enumerate(towns_of(range(settings.towns))):
        places.append(((number + 0.75) / settings.towns, partial(lambda one: one, town)))
    return [known[0], *(town for _, town in sorted(places, key=lambda place: place[0]) if town is not known[0])]


def _metres(town: Town) -> float:
    return sum(lane.length for lane in town.lanes.values())


def _joined(seen: Sequence[Observations]) -> Observations:
    return {key: torch.cat([one[key] for one in seen]) for key in seen[0]}
