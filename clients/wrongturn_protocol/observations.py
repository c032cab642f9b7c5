"""Observations: one table of fields for the Gymnasium spaces, JSON and msgpack.

A track has the same fields for everybody; a rig has those that its agent declares.

Spaces are flat and have no 0-d boxes, because Stable-Baselines3 fails with nested or scalar ones.
"""

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import DTypeLike, NDArray

from wrongturn_protocol.installing import install
from wrongturn_protocol.rigs import NavigationInput, Sight
from wrongturn_protocol.vocabulary import Track

Observation = dict[str, NDArray[Any]]
"""An observation: one array for each key of the track's space."""

PATH_POINTS: Final = 60
"""Points of ``lane`` and of each of ``exits``, 1 m apart."""
ROAD_USERS: Final = 32
"""Rows of ``road_users``."""
IMAGE_SHAPE: Final = (64, 192)
"""Rows and columns of the camera's pictures."""
SENTENCE: Final = 160
"""Bytes of a sentence."""
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
    jpeg: int | None = None
    """Quality of the JPEGs that it is sent as; None for raw bytes."""
    text: bool = False
    """Whether it is UTF-8 with zeros behind, which is sent as a string."""

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
)
_COMMANDS: Final = "-1 VOID, 1 LEFT, 2 RIGHT, 3 STRAIGHT, 4 LANE_FOLLOW."
_NAVIGATION: Final = {
    NavigationInput(field.name): field
    for field in (
        Field("command", np.int64, (1,), -1, 4, _COMMANDS),
        Field("next_command", np.int64, (1,), -1, 4, f"The command after this one. {_COMMANDS}"),
        Field("distance", np.float32, (1,), -1.0, 1e4, "To the next direction's stop line, m; -1 where none comes."),
        Field("target_points", np.float32, (2, 2), -np.inf, np.inf, "Two points of the commanded way: forward, left."),
        Field("sentence", np.uint8, (SENTENCE,), 0, 255, "The command as a sentence, in UTF-8.", text=True),
    )
}
_COMMAND: Final = _NAVIGATION[NavigationInput.COMMAND]
NAVIGATION: Final = frozenset(map(str, NavigationInput))
"""Keys of what a planner tells."""
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
    Track.STATE: (*_ALWAYS, _COMMAND),
    Track.CAMERA: (*_ALWAYS, _COMMAND, _RGB),
    Track.SEGMENTATION: (*_ALWAYS, _COMMAND, _RGB, _SEGMENTATION),
    Track.WORDS: (*_ALWAYS, _NAVIGATION[NavigationInput.SENTENCE], _RGB),
    Track.PRIVILEGED: (*_ALWAYS, _COMMAND, *_PRIVILEGED),
}
"""Fields of each track, in order."""


@lru_cache(maxsize=256)  # agents bring rigs of their own
def fields_of(sight: Sight) -> tuple[Field, ...]:
    """Return the fields of a track or a rig, in order."""
    if isinstance(sight, Track):
        return FIELDS[sight]
    pictures = (
        Field(one.name, np.uint8, one.shape, 0, 255 if one.kind == "rgb" else 10, "A picture.", True, one.jpeg)
        for one in sight.cameras
    )
    return (*_ALWAYS, *(_NAVIGATION[one] for one in sight.navigation), *pictures)


def text(sentence: NDArray[np.uint8]) -> str:
    """Return the text of an observation's ``sentence``."""
    return bytes(sentence).rstrip(b"\0").decode("utf-8", "replace")


def observation_space(sight: Sight, image_shape: tuple[int, int] = IMAGE_SHAPE) -> spaces.Dict:
    """Return the Gymnasium space of a track or rig: a flat ``Dict`` of ``Box``.

    ``image_shape`` is rows and columns of a track's pictures, which may differ in process.
    """

    def box(field: Field) -> spaces.Box:
        shape = (*image_shape, *field.shape[2:]) if field.image and isinstance(sight, Track) else field.shape
        return spaces.Box(field.low, field.high, shape, field.numpy_dtype.type)

    return spaces.Dict({field.name: box(field) for field in fields_of(sight)})


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
    if field.text:
        return {"type": "string", "maxLength": field.shape[0], **about}
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


def encode(observation: Mapping[str, Any], sight: Sight, *, binary: bool = False) -> dict[str, Any]:
    """Return an observation as plain values: for msgpack with raw bytes if ``binary``, else for JSON.

    Pictures that are sent as JPEGs are given as a list of JPEGs, one for each picture of the history.
    """
    message: dict[str, Any] = {}
    for field in fields_of(sight):
        array = observation[field.name]
        if field.jpeg is not None:
            data: Any = [one if binary else base64.b64encode(one).decode("ascii") for one in array]
            message[field.name] = {"shape": list(field.shape), "dtype": field.dtype_name, "jpeg": data}
        elif field.text:
            message[field.name] = text(array)
        elif field.scalar:
            message[field.name] = array.item()
        elif binary or field.image:
            # A view, so that a picture is copied only once, when the message is written.
            raw = np.ascontiguousarray(array).data.cast("B")
            data = raw if binary else base64.b64encode(raw).decode("ascii")
            message[field.name] = {"shape": list(field.shape), "dtype": field.dtype_name, "data": data}
        else:
            message[field.name] = array.tolist()
    return message


def decode(message: Mapping[str, Any], sight: Sight) -> Observation:
    """Return the arrays of an observation from JSON or msgpack; raise ValueError if a field is missing or misshaped."""
    observation: Observation = {}
    for field in fields_of(sight):
        if field.name not in message:
            raise ValueError(f"observation.{field.name}: missing; the {_named(sight)} has it")
        array = _decoded(message[field.name], field.numpy_dtype, field.shape, text=field.text)
        if array.shape != field.shape:
            raise ValueError(
                f"observation.{field.name}: has shape {array.shape}, the {_named(sight)}'s is {field.shape}"
            )
        observation[field.name] = array
    return observation


def decode_rig(message: Mapping[str, Any], *, compressed: bool = False) -> dict[str, Any]:
    """Return the arrays of a rig's observation, which says itself what its pictures are; JPEGs if ``compressed``.

    Raises ValueError.
    """
    if "speed" not in message or "steering" not in message:
        raise ValueError(f"observation: a rig has speed and steering; this has just {', '.join(sorted(message))}")
    observation: dict[str, Any] = {}
    known = {field.name: field for field in (*_ALWAYS, *_NAVIGATION.values())}
    for name, value in message.items():
        if (field := known.get(name)) is not None:
            observation[name] = _decoded(value, field.numpy_dtype, field.shape, text=field.text)
        elif compressed and isinstance(value, Mapping) and "jpeg" in value:
            observation[name] = [base64.b64decode(one) if isinstance(one, str) else one for one in value["jpeg"]]
        elif isinstance(value, Mapping):
            observation[name] = _decoded(value, np.dtype(np.uint8), tuple(map(int, value["shape"])))
        else:
            raise ValueError(f"observation.{name}: is no picture")
    return observation


def _named(sight: Sight) -> str:
    return f"{sight} track" if isinstance(sight, Track) else "rig"


def _decoded(value: Any, dtype: "np.dtype[Any]", shape: tuple[int, ...], *, text: bool = False) -> NDArray[Any]:
    """Return the array of one field; of another shape if the value has another size."""
    if isinstance(value, Mapping) and "jpeg" in value:
        pictures = [picture_of(base64.b64decode(one) if isinstance(one, str) else one) for one in value["jpeg"]]
        return np.stack(pictures).reshape(shape)
    if isinstance(value, Mapping):
        raw = value["data"]
        raw = base64.b64decode(raw) if isinstance(raw, str) else raw
        array = np.frombuffer(raw, dtype).copy()  # writable, as arrays made from lists are
        return array.reshape(shape) if array.size == math.prod(shape) else array
    if text and isinstance(value, str):
        return sentence_of(value)
    return np.array([value] if shape == (1,) else value, dtype)


def sentence_of(words: str) -> NDArray[np.uint8]:
    """Return a text as an observation holds it, (160,)."""
    raw = words.encode()[:SENTENCE]
    return np.frombuffer(raw + bytes(SENTENCE - len(raw)), np.uint8).copy()


def picture_of(jpeg: bytes) -> NDArray[np.uint8]:
    """Return the picture of a JPEG, (height, width, 3), red first. Raises ValueError, ImportError."""
    try:
        import cv2  # noqa: PLC0415 - few rigs need it
    except ImportError as error:
        raise ImportError(f"pictures come as JPEGs; install: {install('opencv-python-headless')}") from error
    found = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
    if found is None:
        raise ValueError("a picture is no JPEG")
    return np.asarray(found, np.uint8)
