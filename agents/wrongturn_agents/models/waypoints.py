"""Waypoints: places where a car should be shortly, read off heat maps, and where they appear in a picture.

From Chen et al., "Learning by Cheating" (CoRL 2019). Places are (forward, left) of the body's centre, metres.
"""

from itertools import pairwise
from typing import Final

import torch
from torch import Tensor, nn

COUNT: Final = 5
"""Number of waypoints."""
APART: Final = 0.5
"""Time between two waypoints, seconds; the first is this far ahead."""
FOCAL: Final = 107.4
"""Of the camera, pixels."""
CENTRE: Final = (96.0, 26.0)
"""Column and row of the camera's optical axis."""
HEIGHT: Final = 1.6
"""Of the camera above the ground, metres."""
SIZE: Final = (192.0, 64.0)
"""Columns and rows of a picture."""
BEFORE: Final = FOCAL * HEIGHT / (SIZE[1] - 0.5 - CENTRE[1])
"""Distance from the camera at which the ground meets a picture's lower edge, metres. Waypoints are moved ahead by this
much before they are projected, so that the nearest ones lie in the picture."""
_HORIZON: Final = 1.0
"""No waypoint lies higher than this many rows below the horizon."""


def soft_argmax(logits: Tensor) -> Tensor:
    """Return the expected place in each heat map (..., rows, columns).

    It is (..., 2): column and row, each from -1 for the first to 1 for the last.
    """
    rows, columns = logits.shape[-2:]
    heat = torch.softmax(logits.float().flatten(-2), -1).reshape(logits.shape)
    across = torch.linspace(-1.0, 1.0, columns, device=logits.device)
    down = torch.linspace(-1.0, 1.0, rows, device=logits.device)
    return torch.stack([(heat.sum(-2) * across).sum(-1), (heat.sum(-1) * down).sum(-1)], -1)


def to_picture(places: Tensor) -> Tensor:
    """Return where places (..., 2) on the ground appear in the picture, (..., 2): column and row, -1 to 1.

    Places are moved ahead by :data:`BEFORE`, and those out of the picture onto its edge.
    """
    depth = (places[..., 0] + BEFORE).clamp_min(0.5 * BEFORE)
    column = CENTRE[0] - FOCAL * places[..., 1] / depth
    row = CENTRE[1] + FOCAL * HEIGHT / depth
    return torch.stack([2.0 * column / SIZE[0] - 1.0, 2.0 * row / SIZE[1] - 1.0], -1).clamp(-1.0, 1.0)


def to_ground(points: Tensor) -> Tensor:
    """Return the places (..., 2) on the ground of points in the picture: the inverse of :func:`to_picture`."""
    column = 0.5 * (points[..., 0] + 1.0) * SIZE[0]
    below = (0.5 * (points[..., 1] + 1.0) * SIZE[1] - CENTRE[1]).clamp_min(_HORIZON)
    depth = FOCAL * HEIGHT / below
    return torch.stack([depth - BEFORE, (CENTRE[0] - column) * depth / FOCAL], -1)


class WaypointHeads(nn.Module):
    """Turns an encoded picture and the speed into waypoints for each command.

    Three transposed convolutions enlarge the encoding eightfold. Then each command has its own heat maps.
    """

    def __init__(self, channels: int, commands: int) -> None:
        super().__init__()
        widths = (channels + 1, channels // 2, channels // 4, channels // 8)
        layers: list[nn.Module] = []
        for wide, narrow in pairwise(widths):
            layers += [nn.BatchNorm2d(wide), nn.ConvTranspose2d(wide, narrow, 3, 2, 1, 1), nn.ReLU()]
        self.enlarge = nn.Sequential(*layers)
        self.maps = nn.ModuleList(
            nn.Sequential(nn.BatchNorm2d(widths[-1]), nn.Conv2d(widths[-1], COUNT, 1)) for _ in range(commands)
        )

    def forward(self, encoded: Tensor, speed: Tensor) -> Tensor:
        """Return points (B, commands, 5, 2), -1 to 1, for (B, channels, rows, columns) and speeds (B, 1), m/s."""
        plane = (speed / 10.0).to(encoded.dtype)[..., None, None].expand(-1, 1, *encoded.shape[2:])
        large = self.enlarge(torch.cat([encoded, plane], 1))
        return soft_argmax(torch.stack([branch(large) for branch in self.maps], 1))
