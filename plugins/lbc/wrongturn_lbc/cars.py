"""Cars that cruise about towns for ever, seen by both agents and by the expert."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wrongturn_agents.training.cars import cruises
from wrongturn_agents.training.world import Groups, eyes_of, with_fewer_road_users
from wrongturn_lbc.config import LBCConfig
from wrongturn_lbc.expert import Situation, situation
from wrongturn_networks import Town
from wrongturn_protocol import Track, TrialOptions
from wrongturn_sim.fleet.camera import FleetCamera
from wrongturn_sim.fleet.fleet import Fleet
from wrongturn_sim.trial_source import TrialSource


class Cars:
    """A number of cars with right commands, each on one drive after the other; with ``pictures``, with a camera each.

    They drive in the settings' towns, in groups. A group that moves on to its next town begins new drives there.

    Attributes:
        ended: verdicts of the drives that ended since it was last emptied.
    """

    def __init__(
        self, count: int, config: LBCConfig, *, seed: int, pictures: bool, device: torch.device, threads: int = 1
    ) -> None:
        random = np.random.default_rng(seed)

        def make(place: int, town: Town, count: int) -> _TownCars:
            eyes = eyes_of(config, count, place) if pictures else None
            return _TownCars(count, config, town, random, eyes, device, threads)

        self.count, self.device = count, device
        self._groups = Groups(replace(config, num_envs=count), make)
        self.ended: list[str] = []
        for cars in self._groups.all():
            cars.begin()

    def observe(self) -> dict[str, Tensor]:
        """Return the privileged observation (count, ...), and ``rgb`` if there are pictures. Steps do not change it."""
        seen = [cars.observe() for cars in self._groups.all()]
        return seen[0] if len(seen) == 1 else {name: torch.cat([one[name] for one in seen]) for name in seen[0]}

    def situation(self, observation: dict[str, Tensor], *, copies: int = 1) -> Situation:
        """Return what the expert knows of the cars in their observation, or in several, one after the other."""
        fleets = [cars.fleet for cars in self._groups.all()]
        turns = np.concatenate([fleet.turns for fleet in fleets])
        permitted = np.concatenate([fleet.permitted for fleet in fleets])
        return situation(
            **{name: observation[name] for name in ("pose", "lane", "stop_line", "exits", "speed", "steering")},
            turn=torch.from_numpy(turns).to(self.device).repeat(copies),
            permitted=torch.from_numpy(permitted).to(self.device).repeat(copies),
        )

    def step(self, actions: Tensor) -> NDArray[np.int64]:
        """Drive on for 0.1 s with steer, throttle and brake (count, 3), and return the cars that began a new drive."""
        clipped = np.clip(actions.float().cpu().numpy(), np.array([-1.0, 0.0, 0.0], np.float32), 1.0)
        groups = zip(self._groups.all(), self._groups.rows, strict=True)
        begun = [rows.start + cars.step(clipped[rows], self.ended) for cars, rows in groups]
        if (group := self._groups.move()) is not None:
            rows = self._groups.rows[group]
            self.ended += ["timeout"] * (rows.stop - rows.start - len(begun[group]))  # the move cuts their drives off
            self._groups.cars(group).begin()
            begun[group] = np.arange(rows.start, rows.stop)
        return np.concatenate(begun)

    def close(self) -> None:
        """Stop the threads."""
        for cars in self._groups.made.values():
            cars.fleet.close()


class _TownCars:
    """The cars of one town."""

    def __init__(
        self,
        count: int,
        config: LBCConfig,
        town: Town,
        random: np.random.Generator,
        eyes: dict[str, Any] | None,
        device: torch.device,
        threads: int,
    ) -> None:
        options = cruises(with_fewer_road_users(config, town))
        beside = options.pop("own_traffic", None)
        self._source = TrialSource(TrialOptions.of(town.name, Track.PRIVILEGED, **options), town)
        self._random, self._device = random, device
        self.fleet = Fleet(town, count, Track.PRIVILEGED, threads=threads, strict=True, record=False, traffic=beside)
        backend = "cuda" if device.type == "cuda" else "cpu"
        self._camera = None
        if eyes is not None:
            self._camera = FleetCamera(self.fleet, track=Track.CAMERA, threads=threads, backend=backend, **eyes)

    def observe(self) -> dict[str, Tensor]:
        seen = {name: torch.from_numpy(array).to(self._device, copy=True)
                for name, array in self.fleet.observation.items()}  # fmt: skip
        if self._camera is not None:
            seen["rgb"] = torch.as_tensor(self._camera.pictures["rgb"], device=self._device).clone()
        return seen

    def step(self, actions: NDArray[np.float32], ended: list[str]) -> NDArray[np.int64]:
        """Drive on, add the verdicts of the drives that ended, and return the cars whose next drive began."""
        self.fleet.step(actions, np.ones(self.fleet.count, np.bool_))
        over = np.flatnonzero(self.fleet.ended)
        ended += [self.fleet.outcome_fields(i)["verdict"] for i in over.tolist()]
        self.begin(over.tolist())
        return over

    def begin(self, which: Sequence[int] | None = None) -> None:
        """Begin the next drives of all cars, or of some, and look."""
        chosen = range(self.fleet.count) if which is None else which
        self.fleet.begin([(i, self._source.draw(self._random)) for i in chosen])
        if self._camera is not None:
            self._camera.render()
