"""A bird's-eye view of what the privileged track tells: seven planes about the car, drawn by tensor arithmetic.

"Learning by Cheating" has planes for road, lane markings, three states of traffic lights, vehicles and pedestrians. The
privileged track knows the lane ahead and the permitted exits as lines, and our towns have no lights. So the seven are:
lane ahead, exits to the left, right and straight on, stop line, vehicles, pedestrians.
"""

from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

PLANES: Final = 7
"""Number of planes."""
PIXELS: Final = 96
"""Rows and columns of a plane."""
CELL: Final = 0.4
"""Size of a pixel, metres."""
AHEAD: Final = 34.2
"""Distance from the car's centre to the farthest row, metres. The first row is the farthest."""
ASIDE: Final = 0.5 * (PIXELS - 1) * CELL
"""Distance to the first column, on the left, and to the last, metres."""
KEYS: Final = ("pose", "lane", "stop_line", "exits", "exits_mask", "road_users", "road_users_count")
"""Keys of the privileged observation that the view shows."""

_FARTHEST: Final = 40
"""Points of a line that are drawn, 1 m apart."""
_LINE: Final = 0.8
"""Standard deviation of a line's brush, metres. Its middle is white over 1.9 m, as wide as the car."""
_PEDESTRIAN: Final = 0.6
_WALKER: Final = 1.2
"""A road user who is shorter is a pedestrian, metres."""
_SOON: Final = 1.0
"""Road users are also drawn, half as bright, where they will be after this time, seconds."""
_BOX: Final = (-0.35, 0.0, 0.35)
"""Places of the brush along a vehicle, in lengths."""


def seen_from_car(points: Tensor, pose: Tensor) -> Tensor:
    """Return points of the town (B, ..., 2) as forward and left of cars at poses (B, 3): x, y, yaw."""
    shape = (-1, *[1] * (points.dim() - 2))
    x, y, yaw = (part.view(shape) for part in pose.to(points.dtype).unbind(1))
    dx, dy = points[..., 0] - x, points[..., 1] - y
    return torch.stack([dx * yaw.cos() + dy * yaw.sin(), dy * yaw.cos() - dx * yaw.sin()], -1)


def birdview(observation: Mapping[str, Tensor]) -> Tensor:
    """Return the view, (B, 7, 96, 96) from 0 to 1, of observations (B, ...) for each of :data:`KEYS`."""
    pose = observation["pose"].float()
    lane = observation["lane"][:, :_FARTHEST]
    exits = observation["exits"][:, :, :_FARTHEST]
    lines = seen_from_car(torch.cat([lane[:, None], exits], 1), pose)
    # The lane is filled up with its last point, which counts once.
    fresh = (lines[:, :, 1:] - lines[:, :, :-1]).square().sum(3) > 0.01
    shown = torch.cat([torch.ones_like(fresh[:, :, :1]), fresh], 2).float()
    there = torch.cat([torch.ones_like(shown[:, :1, 0]), observation["exits_mask"].float()], 1)
    drawn = brushed(lines, shown * there[:, :, None], _LINE)
    visible = (observation["stop_line"] >= 0.0).float()
    stop = brushed(seen_from_car(observation["lane"][:, None, -1:], pose), visible[:, None], _LINE)
    return torch.cat([drawn, stop, _road_users(observation, pose)], 1).clamp(0.0, 1.0)


def brushed(places: Tensor, weights: Tensor, width: float) -> Tensor:
    """Return planes (B, n, 96, 96) with a soft dot at each place (B, n, points, 2), forward and left, metres.

    Weights (B, n, points) are the dots' brightness; ``width`` is their standard deviation, metres.
    """
    cells = CELL * torch.arange(PIXELS, device=places.device, dtype=places.dtype)
    rows = torch.exp(-0.5 * ((places[..., :1] - (AHEAD - cells)) / width).square()) * weights[..., None]
    columns = torch.exp(-0.5 * ((places[..., 1:] - (ASIDE - cells)) / width).square())
    return rows.transpose(2, 3) @ columns


def _road_users(observation: Mapping[str, Tensor], pose: Tensor) -> Tensor:
    """Return the planes of vehicles and of pedestrians, (B, 2, 96, 96)."""
    users = observation["road_users"]
    numbers = torch.arange(users.shape[1], device=users.device)
    there = (numbers < observation["road_users_count"]).float()
    walks = (users[..., 3] < _WALKER).float()
    heading = torch.stack([users[..., 2].cos(), users[..., 2].sin()], -1)
    soon = _SOON * users[..., 5:6] * heading
    along = torch.tensor(_BOX, device=users.device, dtype=users.dtype)[:, None] * users[..., None, 3:4]
    body = users[..., None, :2] + along * heading[..., None, :]
    both = torch.cat([body, body + soon[..., None, :]], 2)
    bright = torch.tensor([1.0] * len(_BOX) + [0.5] * len(_BOX), device=users.device, dtype=users.dtype)
    driving = (there * (1.0 - walks))[..., None] * bright
    vehicles = brushed(seen_from_car(both, pose).flatten(1, 2)[:, None], driving.flatten(1)[:, None], _LINE)
    feet = torch.cat([users[..., :2], users[..., :2] + soon], 1)
    walking = torch.cat([there * walks, 0.5 * there * walks], 1)
    pedestrians = brushed(seen_from_car(feet, pose)[:, None], walking[:, None], _PEDESTRIAN)
    return torch.cat([vehicles, pedestrians], 1)
