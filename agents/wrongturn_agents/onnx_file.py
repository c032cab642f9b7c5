"""What an ONNX file says that onnxruntime does not tell: the opset. Read without the ``onnx`` package.

The file is a ``ModelProto`` in protobuf's encoding (https://protobuf.dev/programming-guides/encoding/), whose field 8
is ``opset_import``: pairs of a domain (1) and a version (2).
"""

from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Final

_OPSET_IMPORT: Final = 8
_DOMAIN: Final = 1
_VERSION: Final = 2
_DEFAULT_DOMAIN: Final = (b"", b"ai.onnx")
_LONGEST: Final = 64  # bytes kept of a value: a domain's name is shorter, and weights need no copy
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


def opset_of(file: Path) -> int:
    """Return the version of ONNX's default domain that a model imports; 0 if it imports none, or is no ONNX model."""
    try:
        with file.open("rb") as opened, mmap(opened.fileno(), 0, access=ACCESS_READ) as data:
            imports = [dict(_fields(value)) for field, value in _fields(data) if field == _OPSET_IMPORT]
    except (OSError, ValueError, IndexError):
        return 0
    versions = [said.get(_VERSION) for said in imports if said.get(_DOMAIN, b"") in _DEFAULT_DOMAIN]
    return max((version for version in versions if isinstance(version, int)), default=0)


def _fields(data: bytes | mmap | int) -> Iterator[tuple[int, bytes | int]]:
    """Yield number and value of each field of a message. Of long bytes it yields the first.

    Raises:
        ValueError: It is no message.
        IndexError: It is cut off.
    """
    if isinstance(data, int):
        raise ValueError("a number stands where a message should")
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        if kind == _VARINT:
            value, at = _varint(data, at)
            yield key >> 3, value
        elif kind == _BYTES:
            size, at = _varint(data, at)
            if at + size > len(data):
                raise ValueError("it is cut off")
            yield key >> 3, data[at : at + min(size, _LONGEST)]
            at += size
        elif kind in {_FIXED64, _FIXED32}:
            at += 8 if kind == _FIXED64 else 4
        else:
            raise ValueError("it is not in protobuf's encoding")


def _varint(data: bytes | mmap, at: int) -> tuple[int, int]:
    """Return the number that begins at a place, and the place after it."""
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("it is not in protobuf's encoding")
