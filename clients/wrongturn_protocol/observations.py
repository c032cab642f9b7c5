"""Observations: one table of fields for the Gymnasium spaces, JSON and msgpack.

Spaces are flat and have no 0-d boxes, because Stable-Baselines3 fails with nested or scalar ones.
"""

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import DTypeLike, NDArray

from wrongturn_protocol.vocabulary import Track

Observation = dict[str, NDArray[Any]]
"""An observation: one array for each key of the track's space."""

PATH_POINTS: Final = 60
"""Points of ``lane`` and of each of ``exits``, 1 m apart."""
ROAD_USERS: Final = 32
"""Rows of ``road_users``."""
IMAGE_SHAPE: Final = (64, 192)
"""Rows and columns of the camera's pictures."""
_LINE: Final = 100


@dataclass(frozen=True)
class Field:
    """One key of an observation."""

    name: str
    dtype: DTypeLike
    shape: tuple[int, ...]
    low: float
    high: float
    meaning: str
    """One sentence for the documentation."""
    image: bool = False
    """Whether it is a picture; pictures are base64 in JSON."""

    @cached_property
    def scalar(self) -> bool:
        """Whether it is sent as a plain number."""
        return self.shape == (1,)

    @cached_property
    def numpy_dtype(self) -> "np.dtype[Any]":
        """The dtype as a numpy object; cached, because making it takes long."""
        return np.dtype(self.dtype)

    @cached_property
    def dtype_name(self) -> str:
        """Name of the dtype, as it is sent."""
        return self.numpy_dtype.name


_ALWAYS: Final = (
    Field("speed", np.float32, (1,), 0.0, 22.0, "Speed, m/s."),
    Field("steering", np.float32, (1,), -1.0, 1.0, "Steering as last applied: -1 is full left, 1 full right."),
    Field("command", np.int64, (1,), -1, 4, "-1 VOID, 1 LEFT, 2 RIGHT, 3 STRAIGHT, 4 LANE_FOLLOW."),
)
_RGB: Final = Field("rgb", np.uint8, (*IMAGE_SHAPE, 3), 0, 255, "The camera's picture, row by row.", image=True)
_SEGMENTATION: Final = Field(
    "segmentation", np.uint8, IMAGE_SHAPE, 0, 10, "Class of each of the picture's pixels.", image=True
)
_PRIVILEGED: Final = (
    Field("pose", np.float64, (3,), -np.inf, np.inf, "x, y (m) and yaw (rad) in the town's frame."),
    Field("lane", np.float32, (PATH_POINTS, 2), -np.inf, np.inf, "Centre line of the lane ahead, points 1 m apart."),
    Field("stop_line", np.float32, (1,), -1.0, 60.0, "Distance to the stop line, m; -1 where none lies within 60 m."),
    Field(
        "exits",
        np.float32,
        (3, PATH_POINTS, 2),
        -np.inf,
        np.inf,
        "Permitted paths from the stop line on, points 1 m apart: LEFT, RIGHT, STRAIGHT.",
    ),
    Field("exits_mask", np.int8, (3,), 0, 1, "1 where that exit exists and is shown, else 0 and the path is zeros."),
    Field(
        "road_users",
        np.float32,
        (ROAD_USERS, 6),
        -np.inf,
        np.inf,
        "The nearest others: x, y, yaw, length, width, speed; zeros past the count.",
    ),
    Field("road_users_count", np.int64, (1,), 0, ROAD_USERS, "Number of rows of road_users that hold somebody."),
)
FIELDS: Final[Mapping[Track, tuple[Field, ...]]] = {
    Track.STATE: _ALWAYS,
    Track.CAMERA: (*_ALWAYS, _RGB),
    Track.SEGMENTATION: (*_ALWAYS, _RGB, _SEGMENTATION),
    Track.PRIVILEGED: (*_ALWAYS, *_PRIVILEGED),
}
"""Fields of each track, in order."""


def observation_space(track: Track, image_shape: tuple[int, int] = IMAGE_SHAPE) -> spaces.Dict:
    """Return the Gymnasium space of a track: a flat ``Dict`` of ``Box``.

    ``image_shape`` is rows and columns of pictures. The service has the default only; in process, cameras may differ.
    """

    def box(field: Field) -> spaces.Box:
        shape = (*image_shape, *field.shape[2:]) if field.image else field.shape
        return spaces.Box(field.low, field.high, shape, field.numpy_dtype.type)

    return spaces.Dict({field.name: box(field) for field in FIELDS[track]})


def json_schema(track: Track) -> dict[str, Any]:
    """Return the JSON Schema of a track's observations in JSON, as :func:`encode` makes them.

    Each property also has the array's type and shape as ``x-dtype`` and ``x-shape``.
    """
    return {
        "description": f"Observation of the {track} track.",
        "type": "object",
        "properties": {field.name: _property(field) for field in FIELDS[track]},
        "required": [field.name for field in FIELDS[track]],
        "additionalProperties": False,
    }


def _property(field: Field) -> dict[str, Any]:
    about = {"description": field.meaning, "x-dtype": field.dtype_name, "x-shape": list(field.shape)}
    if field.image:
        characters = 4 * -(-math.prod(field.shape) * field.numpy_dtype.itemsize // 3)
        properties = {
            "shape": {
                "type": "array",
                "items": {"type": "integer"},
                "minItems": len(field.shape),
                "maxItems": len(field.shape),
            },
            "dtype": {"type": "string", "const": field.dtype_name},
            "data": {
                "type": "string",
                "contentEncoding": "base64",
                "minLength": characters,
                "maxLength": characters,
                "description": f"The values, each from {field.low} to {field.high}.",
            },
        }
        return {
            "type": "object",
            "properties": properties,
            "required": list(properties),
            "additionalProperties": False,
            **about,
        }
    whole = np.issubdtype(field.numpy_dtype, np.integer)
    schema: dict[str, Any] = {"type": "integer" if whole else "number"}
    if math.isfinite(field.low):
        schema |= {"minimum": field.low, "maximum": field.high}
    for length in () if field.scalar else reversed(field.shape):
        schema = {"type": "array", "items": schema, "minItems": length, "maxItems": length}
    return schema | about


def action_space() -> spaces.Box:
    """Return the space of actions, float32 (3,): steer in [-1, 1], throttle and brake in [0, 1]."""
    return spaces.Box(np.array([-1, 0, 0], np.float32), np.array([1, 1, 1], np.float32), dtype=np.float32)


def in_short(space: spaces.Space[Any]) -> str:
    """Return a space in one line, for an error: Gymnasium's text may have hundreds.

    A ``Box`` of many bounds shows the least and the greatest, a ``Dict`` its keys.
    """
    text = str(space)
    if len(text) <= _LINE and "\n" not in text:
        return text
    if isinstance(space, spaces.Box):
        return f"Box({space.low.min()} to {space.high.max()}, {space.shape}, {space.dtype})"
    if isinstance(space, spaces.Dict):
        return f"Dict of {', '.join(map(str, space))}"
    return f"{' '.join(text.split())[:_LINE]}…"


def encode(observation: Observation, track: Track, *, binary: bool = False) -> dict[str, Any]:
    """Return an observation as plain values: for msgpack with raw bytes if ``binary``, else for JSON."""
    message: dict[str, Any] = {}
    for field in FIELDS[track]:
        array = observation[field.name]
        if field.scalar:
            message[field.name] = array.item()
        elif binary or field.image:
            # A view, so that a picture is copied only once, when the message is written.
            raw = np.ascontiguousarray(array).data.cast("B")
            data = raw if binary else base64.b64encode(raw).decode("ascii")
            message[field.name] = {"shape": list(field.shape), "dtype": field.dtype_name, "data": data}
        else:
            message[field.name] = array.tolist()
    return message


def decode(message: Mapping[str, Any], track: Track) -> Observation:
    """Return the arrays of an observation from JSON or msgpack; raise ValueError if a field is missing or misshaped."""
    observation: Observation = {}
    for field in FIELDS[track]:
        if field.name not in message:
            raise ValueError(f"observation.{field.name}: missing; the {track} track has it")
        value = message[field.name]
        if isinstance(value, Mapping):
            raw = value["data"]
            raw = base64.b64decode(raw) if isinstance(raw, str) else raw
            array = np.frombuffer(raw, field.numpy_dtype).copy()  # writable, as arrays made from lists are
            if array.size == math.prod(field.shape):
                array = array.reshape(field.shape)
        elif field.scalar:
            array = np.array([value], field.numpy_dtype)
        else:
            array = np.array(value, field.numpy_dtype)
        if array.shape != field.shape:
            raise ValueError(f"observation.{field.name}: has shape {array.shape}, the {track} track's is {field.shape}")
        observation[field.name] = array
    return observation
