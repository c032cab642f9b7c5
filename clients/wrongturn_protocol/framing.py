"""Frames of RFC 6455 as far as whole binary messages need them; all else is left to the websockets library."""

import struct
from typing import Final

try:
    from websockets.speedups import apply_mask
except ImportError:  # no wheel for this machine
    from websockets.utils import apply_mask

__all__ = ["BINARY", "CONTROL", "FINAL", "MASKED", "apply_mask", "extent", "head"]

BINARY: Final = 0x82
"""First byte of a whole binary message."""
FINAL: Final = 0x80
"""Bit of the first byte: nothing of the message follows."""
CONTROL: Final = 0x08
"""Bit of the first byte: no part of a message."""
MASKED: Final = 0x80
"""Bit of the second byte: a mask of four bytes stands before the payload."""
_TINY: Final = struct.Struct("!BB")
_SHORT: Final = struct.Struct("!BBH")
_LONG: Final = struct.Struct("!BBQ")


def head(length: int, *, masked: bool = False) -> bytes:
    """What stands before a whole binary message of so many bytes, or before its mask."""
    bit = MASKED if masked else 0
    if length < 126:
        return _TINY.pack(BINARY, bit | length)
    if length < 1 << 16:
        return _SHORT.pack(BINARY, bit | 126, length)
    return _LONG.pack(BINARY, bit | 127, length)


def extent(data: bytes | bytearray | memoryview, at: int, end: int) -> tuple[int, int]:
    """Where the payload of the frame that begins there begins and ends; how far is to be read where that is not known.

    Args:
        data: what has come.
        at: the frame's first byte.
        end: of what has come.

    Returns:
        Two indices; the second is beyond ``end`` where the frame is not complete.
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
