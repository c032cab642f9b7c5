"""The messages of ``WS /v1/drive``: msgpack around raw arrays; ``docs/wire.md`` shows them byte by byte.

A message holds one or more calls. Its reply holds the result of each call in the same order:

- call message: ``[number, [call, …]]``; the client chooses the number, and the reply repeats it;
- call: ``["step", episode, seq, steer, throttle, brake]``, ``["next", evaluation, key]``,
  ``["practise", request, key]``, ``["look", episode]`` or ``["abort", episode]``;
- reply message: ``[number, [result, …]]``; the number is nil if the reply is about the connection, not about calls;
- result: ``[status, fields]`` or ``[status, fields, observation]``: status and fields of the REST reply or of its
  problem, and the observation as one block.

A *block* is an observation's arrays one after the other, in the order of
:data:`~wrongturn_protocol.observations.FIELDS`, little-endian. Each array begins at a multiple of 8 bytes; the gaps are
zeros. The block of a rig's observation is its msgpack message instead, which begins with the key ``speed``; an array's
block has zeros there.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Final, NamedTuple

import msgpack
import numpy as np

from wrongturn_protocol.observations import FIELDS, Observation, decode_rig, encode
from wrongturn_protocol.rigs import Rig, Sight
from wrongturn_protocol.vocabulary import Track

PATH: Final = "/v1/drive"
SUBPROTOCOL: Final = "wrongturn.drive.v1"
"""Name of the protocol in the handshake (``Sec-WebSocket-Protocol``); each version has its own name."""
CALLS: Final = 256
"""Most calls in a message, and most calls of a connection that are answered at a time."""
LARGEST: Final = 1 << 18
"""Most bytes of a message of calls: a kibibyte for each."""
RETRY_AFTER: Final = "retry_after_s"
"""Field of a problem that holds HTTP's ``Retry-After``, seconds."""
_ALIGNMENT: Final = 8
_MESSAGE: Final = b"\xa5speed"
"""Second to seventh byte of a rig's block: the msgpack map's first key."""
_TRIPLE: Final = b"\x93"
"""First byte of a msgpack array of three."""


class Call(StrEnum):
    """Kind of a call, with the REST call that does the same."""

    STEP = "step"
    """``POST /v1/episodes/{id}/step``"""
    NEXT = "next"
    """``POST /v1/evaluations/{id}/episodes``"""
    PRACTISE = "practise"
    """``POST /v1/episodes``"""
    LOOK = "look"
    """``GET /v1/episodes/{id}``; the block is the observation of its last reply."""
    ABORT = "abort"
    """``DELETE /v1/episodes/{id}``"""


class MalformedMessageError(ValueError):
    """Data that is not a message of this protocol."""


class TruncatedMessageError(MalformedMessageError):
    """Message that ends before it is complete."""


class Part(NamedTuple):
    """One array of a block."""

    name: str
    dtype: "np.dtype[Any]"
    shape: tuple[int, ...]
    offset: int
    """Position of its first byte."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Positions of a track's arrays in a block."""

    track: Track
    parts: tuple[Part, ...]
    size: int
    """Bytes of the block."""


@cache
def layout(track: Track) -> Layout:
    """Return the layout of a track."""
    parts, end = [], 0
    for field in FIELDS[track]:
        dtype = field.numpy_dtype.newbyteorder("<")
        parts.append(Part(field.name, dtype, field.shape, end))
        length = math.prod(field.shape) * dtype.itemsize
        end += -(-length // _ALIGNMENT) * _ALIGNMENT
    return Layout(track, tuple(parts), end)


_LAYOUTS: Final = {layout(track).size: layout(track) for track in Track}
assert len(_LAYOUTS) == len(Track), "tracks need blocks of different sizes"


class Block:
    """Block in memory into which one observation after the other is written."""

    def __init__(self, memory: bytearray | memoryview, track: Track) -> None:
        """Clear the memory, which has at least the layout's size, and lay out the arrays."""
        self.layout = layout(track)
        memory[: self.layout.size] = bytes(self.layout.size)
        self._arrays = [
            (part.name, np.ndarray(part.shape, part.dtype, memory, part.offset)) for part in self.layout.parts
        ]

    def write(self, observation: Mapping[str, Any]) -> None:
        """Write an observation; raise ValueError if an array has another shape than the track's."""
        for name, array in self._arrays:
            given = observation[name]
            if given.shape != array.shape:
                track = self.layout.track
                raise ValueError(f"observation.{name}: has shape {given.shape}, the {track} track's is {array.shape}")
            array[...] = given


def block(observation: Mapping[str, Any], track: Sight) -> bytes:
    """Return an observation of a track or rig as one block."""
    if isinstance(track, Rig):
        packed: bytes = msgpack.packb(encode(observation, track, binary=True))
        return packed
    memory = bytearray(layout(track).size)
    Block(memory, track).write(observation)
    return bytes(memory)


def arrays(data: bytes | memoryview) -> Observation:
    """Return the arrays of a block, a track's share one copy of it; raise MalformedMessageError if it is none."""
    if data[1:7] == _MESSAGE:
        try:
            return decode_rig(_unpacked(data))
        except (ValueError, KeyError, TypeError) as error:
            raise MalformedMessageError(f"a rig's observation cannot be read: {error}") from error
    found = _LAYOUTS.get(len(data))
    if found is None:
        raise MalformedMessageError(f"no track's observation is a block of {len(data)} bytes")
    memory = bytearray(data)
    return {name: np.ndarray(shape, dtype, memory, offset) for name, dtype, shape, offset in found.parts}


def _bin_header(size: int) -> bytes:
    """Return the msgpack header of so many bytes."""
    if size < 1 << 8:
        return struct.pack(">BB", 0xC4, size)
    return struct.pack(">BH", 0xC5, size) if size < 1 << 16 else struct.pack(">BI", 0xC6, size)


def pack_calls(number: int, calls: Sequence[Sequence[Any]]) -> bytes:
    """Return a message of calls; no other unanswered one has its number, 0 to 2**32 - 1."""
    packed: bytes = msgpack.packb((number, calls))
    return packed


def unpack_calls(data: bytes | memoryview) -> tuple[int, list[Any]]:
    """Return number and calls, unchecked, of a message; raise MalformedMessageError, or TruncatedMessageError."""
    # The library makes room for as many items as an array claims to have.
    message = _unpacked(data, max_array_len=4 * CALLS, max_map_len=CALLS, max_ext_len=0)
    if not (isinstance(message, list) and len(message) == 2 and isinstance(message[1], list)):
        raise MalformedMessageError("a message is an array of a number and an array of calls")
    number, calls = message
    if type(number) is not int or not 0 <= number < 2**32:
        raise MalformedMessageError(f"a message's number is 0 to {2**32 - 1}")
    if not 0 < len(calls) <= CALLS:
        raise MalformedMessageError(f"a message holds 1 to {CALLS} calls, not {len(calls)}")
    return number, calls


def pack_result(status: int, fields: Mapping[str, Any], observation: bytes | memoryview | None = None) -> bytes:
    """Return one result for :func:`join_results`."""
    if observation is None:
        packed: bytes = msgpack.packb((status, fields))
        return packed
    return result_head(status, fields, len(observation)) + observation


def result_head(status: int, fields: Mapping[str, Any], size: int) -> bytes:
    """Return a result up to its observation, which has ``size`` bytes and follows."""
    head: bytes = msgpack.packb((status, fields))
    return _TRIPLE + head[1:] + _bin_header(size)


def results_head(number: int | None, count: int) -> bytes:
    """Return a reply message up to its results, which follow."""
    packed: bytes = msgpack.packb((number, ()))
    length: bytes = msgpack.Packer().pack_array_header(count)
    return packed[:-1] + length  # in place of the empty array


def join_results(number: int | None, results: Sequence[bytes]) -> bytes:
    """Return a reply message of packed results."""
    return b"".join((results_head(number, len(results)), *results))


def unpack_results(data: bytes | memoryview) -> tuple[int | None, list[Any]]:
    """Return number and results of a reply; raise MalformedMessageError."""
    message = _unpacked(data)
    try:
        number, results = message
        for result in results:
            status, fields, *rest = result
            if not (type(status) is int and isinstance(fields, dict) and len(rest) < 2):
                raise MalformedMessageError("a result is an array of a status, a map and perhaps an observation")
    except (TypeError, ValueError) as error:
        raise MalformedMessageError(f"it is no reply message: {error}") from error
    return number, results


def _unpacked(data: bytes | memoryview, **limits: int) -> Any:
    try:
        return msgpack.unpackb(data, **limits)
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:
        if str(error) == "Unpack failed: incomplete input":
            raise TruncatedMessageError(f"the message ends after {len(data)} bytes, before it is complete") from error
        raise MalformedMessageError(f"the message is no msgpack: {str(error)[:200] or type(error).__name__}") from error
