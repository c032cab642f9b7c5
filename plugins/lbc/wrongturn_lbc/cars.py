"""Cars that cruise about a town for ever, seen by both agents and by the expert."""

from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wrongturn_agents.training.cars import cruises
from wrongturn_lbc.config import LBCConfig
from wrongturn_lbc.expert import Situation, situation
from wrongturn_networks import load_town
from wrongturn_protocol import Track, TrialOptions
from wrongturn_sim.camera import Camera
from wrongturn_sim.fleet.camera import FleetCamera
from wrongturn_sim.fleet.fleet import Fleet
from wrongturn_sim.trial_source import TrialSource

TOWN: Final = "Town01"


class Cars:
    """A number of cars with right commands, each on one drive after the other; with ``pictures``, with a camera each.

    Attributes:
        ended: verdicts of the drives that ended since it was last emptied.
    """

    def __init__(
        self, count: int, config: LBCConfig, *, seed: int, pictures: bool, device: torch.device, threads: int = 1
    ) -> None:
        self.count, self.device = count, device
        options = cruises(config)
        beside = options.pop("own_traffic", None)
        self._source = TrialSource(TrialOptions.of(TOWN, Track.PRIVILEGED, **options))
        self._fleet = Fleet(
            load_town(TOWN), count, Track.PRIVILEGED, threads=threads, strict=True, record=False, traffic=beside
        )
        backend = "cuda" if device.type == "cuda" else "cpu"
        self._camera = FleetCamera(self._fleet, Camera(), Track.CAMERA, threads, backend) if pictures else None
        self._random = np.random.default_rng(seed)
        self.ended: list[str] = []
        self._fleet.begin([(i, self._source.draw(self._random)) for i in range(count)])
        self._look()

    def observe(self) -> dict[str, Tensor]:
        """Return the privileged observation (count, ...), and ``rgb`` if there are pictures. Steps do not change it."""
        seen = {name: torch.from_numpy(array).to(self.device, copy=True)
                for name, array in self._fleet.observation.items()}  # fmt: skip
        if self._camera is not None:
            seen["rgb"] = torch.as_tensor(self._camera.pictures["rgb"], device=self.device).clone()
        return seen

    def situation(self, observation: dict[str, Tensor], *, copies: int = 1) -> Situation:
        """Return what the expert knows of the cars in their observation, or in several, one after the other."""
        return situation(
            **{name: observation[name] for name in ("pose", "lane", "stop_line", "exits", "speed", "steering")},
            turn=torch.from_numpy(self._fleet.turns).to(self.device).repeat(copies),
            permitted=torch.from_numpy(self._fleet.permitted).to(self.device).repeat(copies),
        )

    def step(self, actions: Tensor) -> NDArray[np.int64]:
        """Drive on for 0.1 s with steer, throttle and brake (count, 3), and return the cars that began a new drive."""
        fleet = self._fleet
        least = np.array([-1.0, 0.0, 0.0], np.float32)
        fleet.step(np.clip(actions.float().cpu().numpy(), least, 1.0), np.ones(self.count, np.bool_))
        over = np.flatnonzero(fleet.ended)
        self.ended += [fleet.outcome_fields(i)["verdict"] for i in over.tolist()]
        fleet.begin([(i, self._source.draw(self._random)) for i in over.tolist()])
        self._look()
        return over

    def close(self) -> None:
        """Stop the threads."""
        self._fleet.close()

    def _look(self) -> None:
        if self._camera is not None:
            self._camera.render()
