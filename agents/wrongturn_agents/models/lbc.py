"""The two agents of Chen et al., "Learning by Cheating" (CoRL 2019): one that sees the truth, one that sees pictures.

Each tells five waypoints for every command. The commanded ones become controls (:class:`WaypointControl`).
"""

from collections.abc import Mapping, Sequence
from typing import Final

import torch
from torch import Tensor, nn

from wrongturn_agents.models.birdview import AHEAD, ASIDE, CELL, KEYS, PIXELS, PLANES, birdview
from wrongturn_agents.models.branches import COMMANDS, branch_of
from wrongturn_agents.models.inputs import encoding_dtype, planes, wanted
from wrongturn_agents.models.resnet import DEPTHS_18, DEPTHS_34, new_resnet
from wrongturn_agents.models.waypoint_control import MEMORY, WaypointControl
from wrongturn_agents.models.waypoints import WaypointHeads, to_ground

_MEASURED: Final = ("speed", "command")


class WaypointAgent(nn.Module):
    """An agent that tells waypoints for all commands, and follows those of the command that it gets.

    Args:
        depths: blocks in each stage of its ResNet.
        width: channels after the first stage; each stage has twice as many as the one before.

    Attributes:
        keys: keys of the observation that it needs.
    """

    keys: Sequence[str] = ()

    def __init__(self, channels: int, depths: Sequence[int], width: int) -> None:
        super().__init__()
        self.encoder = new_resnet(channels, depths, [width * 2**stage for stage in range(len(depths))])
        self.heads = WaypointHeads(8 * width, len(COMMANDS))
        self.control = WaypointControl()

    def picture(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the encoder's input, (B, channels, rows, columns)."""
        raise NotImplementedError

    def place(self, points: Tensor) -> Tensor:
        """Return the places on the ground of points in the heat maps, (..., 2)."""
        raise NotImplementedError

    def points(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return points in the heat maps for each command, (B, 4, 5, 2), -1 to 1."""
        picture = self.picture(observation)
        encoded: Tensor = self.encoder(picture).last_hidden_state
        points: Tensor = self.heads(encoded, observation["speed"])
        return points

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the waypoints for each command, (B, 4, 5, 2): forward and left, metres."""
        return self.place(self.points(observation))

    def begin(self, count: int) -> Tensor:
        """Return the memory of cars that begin their drives, (count, MEMORY)."""
        return torch.zeros(count, MEMORY, device=next(self.parameters()).device)

    def drive_on(self, observation: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return steer, throttle and brake (B, 3), and the new memory (B, MEMORY)."""
        waypoints = commanded(self(observation), observation["command"])
        driven: tuple[Tensor, Tensor] = self.control(waypoints, observation["speed"], memory)
        return driven


class PrivilegedAgent(WaypointAgent):
    """The agent that cheats: it sees the lane, the exits and the road users from above."""

    keys = (*_MEASURED, *KEYS)

    def __init__(self, width: int = 64) -> None:
        super().__init__(PLANES, DEPTHS_18, width)

    def picture(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the bird's-eye view, (B, 7, 96, 96)."""
        return birdview(observation)

    def place(self, points: Tensor) -> Tensor:
        """Return the places of points in the view."""
        ahead = AHEAD - 0.5 * (points[..., 1] + 1.0) * (PIXELS - 1) * CELL
        return torch.stack([ahead, -ASIDE * points[..., 0]], -1)


class SensorimotorAgent(WaypointAgent):
    """The agent that learns from the other: it sees the camera's picture."""

    keys = (*_MEASURED, "rgb")

    def __init__(self, width: int = 64) -> None:
        super().__init__(3, DEPTHS_34, width)

    def picture(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the pictures, (B, 3, 64, 192) in [-1, 1]."""
        return planes(wanted(observation, "rgb"), encoding_dtype(next(self.encoder.parameters())))

    def place(self, points: Tensor) -> Tensor:
        """Return the places on the ground of points in the picture."""
        return to_ground(points)


def commanded(waypoints: Tensor, command: Tensor) -> Tensor:
    """Return each car's commanded part of waypoints (B, 4, ...) for commands (B, 1); VOID takes LANE_FOLLOW's."""
    index = branch_of(command).view(-1, *[1] * (waypoints.dim() - 1)).expand(-1, 1, *waypoints.shape[2:])
    return waypoints.gather(1, index)[:, 0]
