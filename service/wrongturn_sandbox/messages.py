"""What host and guest say to each other, and the strict reading of it.

====================================================  =====================================================
host                                                  guest
====================================================  =====================================================
``{"begin": version, "memory", …}``: the limits        ``{"ready": version, "runtime": "onnxruntime 1.31"}``
``{"load": length}`` and a frame with the model       ``{"description": {...}}``
``{"run": {name: [dtype, shape, bytes]}}``            ``{"outputs": {name: [dtype, shape, bytes]}}``
====================================================  =====================================================

To any of them a guest may answer ``{"refused": reason}``. Instead of ``ready`` a listener may say
``{"unavailable": reason}`` or ``{"busy": reason}``, and ``{"ended": status}`` once its guest has ended.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from wrongturn_sandbox.frames import FrameError
from wrongturn_sandbox.rules import METADATA_LENGTH_MOST, METADATA_MOST, NAME_MOST, TENSORS_MOST

_S = TypeVar("_S", dict[Any, Any], list[Any], str)
DTYPES: Final = frozenset(
    ["bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float16", "float32", "float64"]
)
"""numpy's names of the types that tensors may have on their way in and out."""
RANK_MOST: Final = 8
"""Most axes of a tensor on its way in or out."""


@dataclass(frozen=True)
class Limits:
    """What a sandbox allows a model."""

    memory: int
    """Bytes that the model may take beyond what the empty runtime takes."""
    load_s: float = 5.0
    """Seconds to check and load the model."""
    step_s: float = 2.0
    """Seconds that a step may take."""
    life_s: float = 120.0
    """Seconds of processor time that the sandbox may take in all. The kernel ends it then, whatever the model does."""
    gpu: bool = False
    """Whether the model is computed on a GPU. It then reaches the GPU's driver."""


@dataclass(frozen=True)
class TensorInfo:
    """An input or output of a model."""

    name: str
    """Its name in the graph."""
    dtype: str
    """numpy's name of its type: ``float32``."""
    shape: tuple[int | str | None, ...]
    """Its axes; a free axis is its name, or None where it has none."""


@dataclass(frozen=True)
class Description:
    """What the guest says about a model that it has loaded."""

    inputs: tuple[TensorInfo, ...]
    outputs: tuple[TensorInfo, ...]
    opset: int
    """Version of the default operators."""
    metadata: Mapping[str, str]
    """The file's own words about itself."""
    nodes: int
    parameters: int
    """Numbers in the graph's initialisers."""


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as plain values. Raises ValueError for a type or a number of axes that does not go in or out."""
    for name, array in arrays.items():
        if array.dtype.name not in DTYPES or array.ndim > RANK_MOST:
            raise ValueError(f"{name}: {array.dtype.name} with {array.ndim} axes")
    return {name: [array.dtype.name, list(array.shape), array.tobytes()] for name, array in arrays.items()}


def read_arrays(value: object) -> dict[str, NDArray[Any]]:
    """Return arrays of what :func:`pack_arrays` made. Distrusts all of it, and raises FrameError."""
    return {_sized(name, str, NAME_MOST): _array(array) for name, array in _sized(value, dict, TENSORS_MOST).items()}


def read_description(value: object) -> Description:
    """Return the description of its plain values. Distrusts all of it, and raises FrameError."""
    said = _fields(value, Description)
    return Description(
        inputs=tuple(map(_tensor, _sized(said["inputs"], list, TENSORS_MOST))),
        outputs=tuple(map(_tensor, _sized(said["outputs"], list, TENSORS_MOST))),
        opset=_count(said["opset"]),
        metadata={
            _sized(key, str, METADATA_LENGTH_MOST): _sized(words, str, METADATA_LENGTH_MOST)
            for key, words in _sized(said["metadata"], dict, METADATA_MOST).items()
        },
        nodes=_count(said["nodes"]),
        parameters=_count(said["parameters"]),
    )


def read_reply(value: object) -> tuple[str, Any]:
    """Return the one key of a reply, and its value. Raises FrameError."""
    said = _sized(value, dict, 2)
    kind = next(iter(said), None)
    if kind not in {"ready", "description", "outputs", "refused", "unavailable", "busy", "ended"}:
        raise FrameError("an unknown reply")
    if kind != "ready" and len(said) != 1:
        raise FrameError("a reply with two meanings")
    return kind, said if kind == "ready" else said[kind]


def _array(value: object) -> NDArray[Any]:
    parts = _sized(value, list, 3)
    if len(parts) != 3 or not _is_dtype(parts[0]) or not isinstance(parts[2], bytes):
        raise FrameError("no array")
    dtype = np.dtype(parts[0])
    shape = tuple(_count(length) for length in _sized(parts[1], list, RANK_MOST))
    if math.prod(shape) * dtype.itemsize != len(parts[2]):
        raise FrameError("an array of another length than its shape")
    return np.frombuffer(parts[2], dtype).reshape(shape)


def _is_dtype(value: object) -> bool:
    return isinstance(value, str) and value in DTYPES


def _tensor(value: object) -> TensorInfo:
    said = _fields(value, TensorInfo)
    if not _is_dtype(said["dtype"]):
        raise FrameError("no description of a tensor")
    shape = tuple(
        _sized(length, str, NAME_MOST) if isinstance(length, str) else None if length is None else _count(length)
        for length in _sized(said["shape"], list, 64)
    )
    return TensorInfo(_sized(said["name"], str, NAME_MOST), said["dtype"], shape)


def _fields(value: object, of: type[TensorInfo | Description]) -> dict[str, Any]:
    wanted = {field.name for field in fields(of)}
    said = _sized(value, dict, len(wanted))
    if set(said) != wanted:
        raise FrameError(f"no {of.__name__}")
    return said


def _sized(value: object, kind: type[_S], most: int) -> _S:
    if not isinstance(value, kind) or len(value) > most:
        raise FrameError(f"no {kind.__name__}, or a too long one")
    return value


def _count(value: object) -> int:
    if type(value) is not int or not 0 <= value < 1 << 62:
        raise FrameError("no count")
    return value
