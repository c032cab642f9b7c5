"""Actions as they are used, hashed and stored."""

import struct
from typing import Final

Action = tuple[float, float, float]
"""Steer, throttle, brake, each already a float32."""
ACTION: Final = struct.Struct("<3f")
"""Little-endian float32, steer, throttle, brake."""


def rounded(steer: float, throttle: float, brake: float) -> Action:
    """Values, each in its range, as they are used: what differs by less than a float32 is the same action."""
    triple: Action = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple
