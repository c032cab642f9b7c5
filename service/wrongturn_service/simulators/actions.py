"""Actions as they are driven: float32, so that values that round to the same ones are the same action."""

import struct
from typing import Final

Action = tuple[float, float, float]
"""Steer, throttle, brake, each already a float32."""
ACTION: Final = struct.Struct("<3f")
"""Little-endian float32: steer, throttle, brake."""


def rounded(steer: float, throttle: float, brake: float) -> Action:
    """Return the action as it is driven."""
    triple: Action = ACTION.unpack(ACTION.pack(steer, throttle, brake))
    return triple
