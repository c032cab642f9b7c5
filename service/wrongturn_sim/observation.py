"""What an agent is shown, built from the state. ``docs/observations.md`` explains the keys."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from wrongturn_protocol import Command, Track
from wrongturn_protocol.observations import ROAD_USERS, Observation
from wrongturn_sim.ego import EgoState
from wrongturn_sim.errors import TrackNotAvailableError
from wrongturn_sim.route import Navigator
from wrongturn_sim.trajectory import RoadUser

AVAILABLE_TRACKS: Final = (Track.STATE, Track.PRIVILEGED)
"""The tracks that this version can show."""


def check_track(track: Track) -> None:
    """Refuse a track that cannot be shown.

    Raises:
        TrackNotAvailableError: the track needs the camera.
    """
    if track not in AVAILABLE_TRACKS:
        raise TrackNotAvailableError(
            f"track: {track} needs the camera, which is not there yet; take one of {', '.join(AVAILABLE_TRACKS)}",
        )


def observe_state(ego: EgoState, command: Command) -> Observation:
    """The keys of every track, as fresh arrays."""
    return {
        "speed": np.array((ego.v,), np.float32),
        "steering": np.array((ego.steering,), np.float32),
        "command": np.array((command,), np.int64),
    }


def observe_privileged(
    ego: EgoState,
    command: Command,
    navigator: Navigator,
    road_users: Sequence[RoadUser],
) -> Observation:
    """All keys of the privileged track, as fresh arrays: no route among them, nor the fault."""
    observation = observe_state(ego, command)
    exits, mask = navigator.exits()
    users = np.zeros((ROAD_USERS, 6), np.float32)
    count = min(len(road_users), ROAD_USERS)
    if count:
        users[:count] = road_users[:count]
    observation.update(
        pose=np.array((ego.x, ego.y, ego.yaw), np.float64),
        lane=navigator.lane_ahead(),
        stop_line=np.array((navigator.stop_line,), np.float32),
        exits=exits,
        exits_mask=mask,
        road_users=users,
        road_users_count=np.array((count,), np.int64),
    )
    return observation
