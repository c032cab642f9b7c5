"""The privileged observation as the car sees it."""

import math
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TransformObservation
from numpy.typing import NDArray

from wrongturn_protocol.observations import ROAD_USERS, Observation

FARTHEST: Final = 200.0
"""Coordinates are clipped to this many metres. Paths and road users of an episode lie nearer."""
_KEYS: Final = ("pose", "lane", "exits", "exits_mask", "road_users", "road_users_count")


class CarFrame(TransformObservation[Any, Any, Any], RecordConstructorArgs):
    """Turn ``lane``, ``exits`` and ``road_users`` from the town's frame to the car's, and leave ``pose`` out.

    x points ahead and y to the left, from the middle of the body, in metres; yaws are relative to the car's, in
    [-pi, pi]. Exits that are not there and rows past ``road_users_count`` stay zeros. All bounds are finite.

    Raises:
        ValueError: Observations are not those of the privileged track.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not set(_KEYS) <= space.spaces.keys():
            raise ValueError(
                "CarFrame: observations have no pose and no paths; make the environment with track='privileged', and "
                "put CarFrame before wrappers that leave keys out"
            )
        changed = dict(space.spaces)
        del changed["pose"]
        for name in ("lane", "exits"):
            changed[name] = spaces.Box(-FARTHEST, FARTHEST, space[name].shape, np.float32)
        low = np.zeros((ROAD_USERS, 6), np.float32)
        low[:, :2], low[:, 2] = -FARTHEST, -math.pi
        high = np.full((ROAD_USERS, 6), FARTHEST, np.float32)
        high[:, 2] = math.pi
        changed["road_users"] = spaces.Box(low, high, dtype=np.float32)
        TransformObservation.__init__(self, env, _seen_from_the_car, spaces.Dict(changed))


def _seen_from_the_car(seen: Observation) -> Observation:
    pose = seen["pose"]
    turned = {name: array for name, array in seen.items() if name != "pose"}
    turned["lane"] = _points(seen["lane"], pose)
    there = seen["exits_mask"].astype(np.bool_)
    turned["exits"] = np.where(there[:, None, None], _points(seen["exits"], pose), np.float32(0))
    users = seen["road_users"].copy()
    count = int(seen["road_users_count"][0])
    users[:count, :2] = _points(users[:count, :2], pose)
    # float32 of pi lies above pi, so the result is kept within the space.
    users[:count, 2] = np.clip(_angles(users[:count, 2] - pose[2]), -np.float32(math.pi), np.float32(math.pi))
    turned["road_users"] = users
    return turned


def _points(points: NDArray[np.float32], pose: NDArray[np.float64]) -> NDArray[np.float32]:
    east, north = points[..., 0] - pose[0], points[..., 1] - pose[1]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    turned = np.stack([cos * east + sin * north, cos * north - sin * east], axis=-1)
    return np.asarray(np.clip(turned, -FARTHEST, FARTHEST), np.float32)


def _angles(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    return (angles + math.pi) % (2.0 * math.pi) - math.pi
