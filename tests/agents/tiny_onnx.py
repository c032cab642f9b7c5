"""Smallest ONNX models, encoded by hand so that no test needs the onnx package."""

from collections.abc import Mapping, Sequence
from pathlib import Path

FLOAT, UINT8, INT64 = 1, 2, 7


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*out, value))


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _blob(field: int, value: bytes | str) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _value_info(name: str, dtype: int, shape: Sequence[int]) -> bytes:
    dims = b"".join(_blob(1, _number(1, size)) for size in shape)
    return _blob(1, name) + _blob(2, _blob(1, _number(1, dtype) + _blob(2, dims)))


def write_concat_model(
    file: Path,
    inputs: Sequence[str],
    *,
    output: str = "action",
    opset: int = 13,
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Return a model that concatenates its float32 (1, 1) inputs; three of them make an action."""
    attribute = _blob(1, "axis") + _number(3, 1) + _number(20, 2)
    node = b"".join(_blob(1, name) for name in inputs) + _blob(2, output) + _blob(4, "Concat") + _blob(5, attribute)
    graph = _blob(1, node) + _blob(2, "graph")
    graph += b"".join(_blob(11, _value_info(name, FLOAT, (1, 1))) for name in dict.fromkeys(inputs))
    graph += _blob(12, _value_info(output, FLOAT, (1, len(inputs))))
    model = _number(1, 8) + _blob(7, graph) + _blob(8, _blob(1, "") + _number(2, opset))
    for key, value in (metadata or {}).items():
        model += _blob(14, _blob(1, key) + _blob(2, value))
    file.write_bytes(model)
    return file
