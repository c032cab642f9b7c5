"""WebSocket frames (RFC 6455) of whole binary messages; the websockets library handles all other frames."""

import struct
from typing import Final

try:
    from websockets.speedups import apply_mask
except ImportError:  # no wheel for this machine
    from websockets.utils import apply_mask

__all__ = ["BINARY", "CONTROL", "FINAL", "MASKED", "apply_mask", "extent", "head"]

BINARY: Final = 0x82
"""First byte of a frame that is a whole binary message."""
FINAL: Final = 0x80
"""Bit of the first byte: the frame ends its message."""
CONTROL: Final = 0x08
"""Bit of the first byte: a control frame, which is no part of a message."""
MASKED: Final = 0x80
"""Bit of the second byte: a mask of four bytes comes before the payload."""
_TINY: Final = struct.Struct("!BB")
_SHORT: Final = struct.Struct("!BBH")
_LONG: Final = struct.Struct("!BBQ")


def head(length: int) -> bytes:
    """Return the head of an unmasked frame: what comes before the payload of ``length`` bytes."""
    if length < 126:
        return _TINY.pack(BINARY, length)
    if length < 1 << 16:
        return _SHORT.pack(BINARY, 126, length)
    return _LONG.pack(BINARY, 127, length)


def extent(data: bytes | bytearray | memoryview, at: int, end: int) -> tuple[int, int]:
    """Return the indices of the begin and end of a frame's payload.

    The frame begins at ``at``, and bytes were received up to before ``end``. If the payload ends beyond, read up to
    there and ask again.
    """
    begin = at + 2
    if end < begin:
        return begin, begin
    length = data[at + 1] & 127
    if length == 126:
        begin += 2
        if end < begin:
            return begin, begin
        length = _SHORT.unpack_from(data, at)[2]
    elif length == 127:
        begin += 8
        if end < begin:
            return begin, begin
        length = _LONG.unpack_from(data, at)[2]
    if data[at + 1] & MASKED:
        begin += 4
    return begin, begin + length
