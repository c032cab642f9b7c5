"""Observations, built from the car's state. ``docs/observations.md`` explains the keys."""

from collections.abc import Sequence

import numpy as np

from wrongturn_judge.trajectory import RoadUser
from wrongturn_protocol import Command
from wrongturn_protocol.observations import ROAD_USERS, Observation
from wrongturn_sim.ego import State
from wrongturn_sim.route import Navigator


def observe_state(state: State, command: Command) -> Observation:
    """Return the keys that all tracks have, as new arrays."""
    # The fastest way to make a new array is to fill an empty one.
    speed, steering, named = np.empty(1, np.float32), np.empty(1, np.float32), np.empty(1, np.int64)
    speed[0], steering[0], named[0] = state[3], state[4], command
    return {"speed": speed, "steering": steering, "command": named}


def observe_privileged(
    state: State, command: Command, navigator: Navigator, road_users: Sequence[RoadUser]
) -> Observation:
    """Return all keys of the privileged track, as new arrays; they reveal neither the route nor the fault."""
    observation = observe_state(state, command)
    exits, mask = navigator.exits()
    users = np.zeros((ROAD_USERS, 6), np.float32)
    count = min(len(road_users), ROAD_USERS)
    if count:
        users[:count] = road_users[:count]
    observation.update(
        pose=np.array(state[:3], np.float64),
        lane=navigator.lane_ahead(),
        stop_line=np.array((navigator.stop_line,), np.float32),
        exits=exits,
        exits_mask=mask,
        road_users=users,
        road_users_count=np.array((count,), np.int64),
    )
    return observation
