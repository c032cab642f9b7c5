"""The truth about affordances: where a car is on its road, from its pose and the town's geometry."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from wrongturn_agents.training.methods.places import points_of
from wrongturn_marln.affordances import FARTHEST, Affordances
from wrongturn_networks import Town

_HEADING = 3.0
"""Metres that a radian of heading counts as, so that a car is on the lane in its own direction."""


class RoadTruth:
    """Tells the affordances of any place in a town."""

    def __init__(self, town: Town) -> None:
        from scipy.spatial import cKDTree  # noqa: PLC0415 - takes half a second

        points = points_of(town)
        self._poses, self._distance = points.poses, points.distance
        self._tree = cKDTree(_placed(self._poses))

    def of(self, poses: NDArray[np.float64], device: torch.device | str = "cpu") -> Affordances:
        """Return the affordances of poses (n, 3): x, y, yaw of the bodies' centres."""
        _, nearest = self._tree.query(_placed(poses))
        lane, left = self._poses[nearest], self._distance[nearest]
        cos, sin = np.cos(lane[:, 2]), np.sin(lane[:, 2])
        east, north = poses[:, 0] - lane[:, 0], poses[:, 1] - lane[:, 1]
        angle = poses[:, 2] - lane[:, 2]
        told = (
            left == 0.0,
            np.clip(left - (east * cos + north * sin), 0.0, FARTHEST) * (left > 0.0),
            north * cos - east * sin,
            np.arctan2(np.sin(angle), np.cos(angle)),
        )
        return Affordances(*(torch.as_tensor(one.astype(np.float32), device=device) for one in told))


class RoadTruths:
    """Tells the affordances of cars in several towns. The roads of a town are the same in all of its sceneries."""

    def __init__(self) -> None:
        self._of: dict[str, RoadTruth] = {}

    def of(
        self, poses_by_town: Sequence[tuple[Town, NDArray[np.float64]]], device: torch.device | str = "cpu"
    ) -> Affordances:
        """Return the affordances of poses (n, 3) in each of some towns, one after the other."""
        for town, _ in poses_by_town:
            if town.name not in self._of:
                self._of[town.name] = RoadTruth(town)
        found = [self._of[town.name].of(poses, device) for town, poses in poses_by_town]
        return Affordances(*(torch.cat(column) for column in zip(*found, strict=True)))


def _placed(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places and headings as points in four dimensions."""
    turned = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], 1)
    return np.concatenate([poses[:, :2], _HEADING * turned], 1)
