"""The messages of ``WS /v1/drive``: msgpack around raw arrays; ``docs/wire.md`` shows them byte by byte.

A message holds one or more calls, its reply the result of each in the same order:

- call message: ``[number, [call, …]]``; the number is the client's own, and its reply bears it again;
- call: ``["step", episode, seq, steer, throttle, brake]``, ``["next", evaluation, key]``,
  ``["practise", request, key]``, ``["look", episode]`` or ``["abort", episode]``;
- reply message: ``[number, [result, …]]``; what concerns no call but the connection has the number nil;
- result: ``[status, fields]`` or ``[status, fields, observation]``: the status and the fields of the REST call, or of
  its problem, and the observation as one block.

A *block* is an observation's arrays one after the other, in the order of
:data:`~wrongturn_protocol.observations.FIELDS`, little-endian, each beginning at a multiple of 8 bytes, with zeros
between.
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

from wrongturn_protocol.observations import FIELDS, Observation
from wrongturn_protocol.vocabulary import Track

PATH: Final = "/v1/drive"
SUBPROTOCOL: Final = "wrongturn.drive.v1"
"""What both sides name in the handshake (``Sec-WebSocket-Protocol``); another version is another name."""
CALLS: Final = 256
"""Calls of a message at most, and calls of a connection that are answered at a time."""
RETRY_AFTER: Final = "retry_after_s"
"""A problem's field for what ``Retry-After`` says over HTTP, seconds."""
_ALIGNMENT: Final = 8
_TRIPLE: Final = b"\x93"
"""An array of three follows."""
_NIL: Final = b"\xc0"
_ARRAYS: Final = tuple(bytes((0x90 | count,)) for count in range(16))
"""By count, an array of so many follows."""
_BIN8: Final = struct.Struct(">BB")
_BIN16: Final = struct.Struct(">BH")
_BIN32: Final = struct.Struct(">BI")


class Call(StrEnum):
    """What a call asks for, with the REST call of the same meaning."""

    STEP = "step"
    """``POST /v1/episodes/{id}/step``"""
    NEXT = "next"
    """``POST /v1/evaluations/{id}/episodes``"""
    PRACTISE = "practise"
    """``POST /v1/episodes``"""
    LOOK = "look"
    """``GET /v1/episodes/{id}``; its last reply's observation is the block."""
    ABORT = "abort"
    """``DELETE /v1/episodes/{id}``"""


class MalformedMessageError(ValueError):
    """It is no message of this protocol."""


class TruncatedMessageError(MalformedMessageError):
    """It ends before it is complete."""


class Part(NamedTuple):
    """One array of a block."""

    name: str
    dtype: "np.dtype[Any]"
    shape: tuple[int, ...]
    offset: int
    """Of its first byte."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a track's arrays lie in a block."""

    track: Track
    parts: tuple[Part, ...]
    size: int
    """Of the block, bytes."""


@cache
def layout(track: Track) -> Layout:
    """A track's layout."""
    parts, end = [], 0
    for field in FIELDS[track]:
        dtype = field.numpy_dtype.newbyteorder("<")
        parts.append(Part(field.name, dtype, field.shape, end))
        length = math.prod(field.shape) * dtype.itemsize
        end += -(-length // _ALIGNMENT) * _ALIGNMENT
    return Layout(track, tuple(parts), end)


_LAYOUTS: Final = {layout(track).size: layout(track) for track in Track}
assert len(_LAYOUTS) == len(Track), "a block's length tells its track"


class Block:
    """An observation's block in memory that is written to again and again."""

    def __init__(self, memory: bytearray | memoryview, track: Track) -> None:
        """Lay it out; nothing of it is kept of what was there.

        Args:
            memory: the layout's size, or more.
            track: whose observations are written.
        """
        self.layout = layout(track)
        memory[: self.layout.size] = bytes(self.layout.size)
        self._arrays = [
            (part.name, np.ndarray(part.shape, part.dtype, memory, part.offset)) for part in self.layout.parts
        ]

    def write(self, observation: Observation) -> None:
        """Write an observation.

        Args:
            observation: arrays of the track's dtypes and shapes.

        Raises:
            ValueError: an array has another shape.
        """
        for name, array in self._arrays:
            given = observation[name]
            if given.shape != array.shape:
                track = self.layout.track
                raise ValueError(f"observation.{name}: has shape {given.shape}, the {track} track's is {array.shape}")
            array[...] = given


def block(observation: Observation, track: Track) -> bytes:
    """An observation as one block.

    Args:
        observation: arrays of the track's dtypes and shapes.
        track: whose.
    """
    memory = bytearray(layout(track).size)
    Block(memory, track).write(observation)
    return bytes(memory)


def track_of_block(size: int) -> Track:
    """Which track a block of so many bytes is of.

    Raises:
        MalformedMessageError: of none.
    """
    found = _LAYOUTS.get(size)
    if found is None:
        raise MalformedMessageError(f"no track's observation is a block of {size} bytes")
    return found.track


def arrays(data: bytes | memoryview) -> Observation:
    """The arrays of a block, the caller's own to keep and to change: they share one copy of it.

    Raises:
        MalformedMessageError: no track has blocks of this length.
    """
    found = _LAYOUTS.get(len(data))
    if found is None:
        raise MalformedMessageError(f"no track's observation is a block of {len(data)} bytes")
    memory = bytearray(data)
    return {name: np.ndarray(shape, dtype, memory, offset) for name, dtype, shape, offset in found.parts}


def _bin_header(size: int) -> bytes:
    """What stands before so many bytes."""
    if size < 1 << 8:
        return _BIN8.pack(0xC4, size)
    if size < 1 << 16:
        return _BIN16.pack(0xC5, size)
    return _BIN32.pack(0xC6, size)


_BLOCK_HEADERS: Final = tuple((size, _bin_header(size)) for size in sorted(_LAYOUTS, reverse=True))


def pack_calls(number: int, calls: Sequence[Sequence[Any]]) -> bytes:
    """A message of calls.

    Args:
        number: 0 to 2**32 - 1, of none that is still to be answered.
        calls: as the module describes.
    """
    packed: bytes = msgpack.packb((number, calls))
    return packed


def unpack_calls(data: bytes | memoryview) -> tuple[int, list[Any]]:
    """Number and calls of a message; the calls themselves are looked at one by one, by whoever answers them.

    Raises:
        TruncatedMessageError, MalformedMessageError.
    """
    message = _unpacked(data)
    if not (isinstance(message, list) and len(message) == 2 and isinstance(message[1], list)):
        raise MalformedMessageError("a message is an array of a number and an array of calls")
    number, calls = message
    if type(number) is not int or not 0 <= number < 2**32:
        raise MalformedMessageError(f"a message's number is 0 to {2**32 - 1}")
    if not 0 < len(calls) <= CALLS:
        raise MalformedMessageError(f"a message holds 1 to {CALLS} calls, not {len(calls)}")
    return number, calls


def pack_result(status: int, fields: Mapping[str, Any], observation: bytes | memoryview | None = None) -> bytes:
    """One result, ready to be set into a reply message."""
    if observation is None:
        packed: bytes = msgpack.packb((status, fields))
        return packed
    return result_head(status, fields, len(observation)) + observation


def result_head(status: int, fields: Mapping[str, Any], size: int) -> bytes:
    """What stands before the observation in a result that has one of so many bytes."""
    head: bytes = msgpack.packb((status, fields))
    return _TRIPLE + head[1:] + _bin_header(size)


def results_head(number: int | None, count: int) -> bytes:
    """What stands before the results in a reply message of so many."""
    packed: bytes
    if count < len(_ARRAYS):
        packed = msgpack.packb((number, ()))
        return packed[:-1] + _ARRAYS[count]  # instead of the empty array's
    packer = msgpack.Packer(autoreset=False)
    packer.pack_array_header(2)
    packer.pack(number)
    packer.pack_array_header(count)
    packed = packer.bytes()
    return packed


def join_results(number: int | None, results: Sequence[bytes]) -> bytes:
    """A reply message of packed results."""
    return b"".join((results_head(number, len(results)), *results))


def unpack_results(data: bytes | memoryview) -> tuple[int | None, list[Any]]:
    """Number and results of a reply message; a block may be a view of the data.

    Raises:
        TruncatedMessageError, MalformedMessageError.
    """
    message = _around_block(data) or _unpacked(data)
    try:
        number, results = message
        for result in results:
            status, fields, *rest = result
            if not (type(status) is int and isinstance(fields, dict) and len(rest) < 2):
                raise MalformedMessageError("a result is an array of a status, a map and perhaps an observation")
    except (TypeError, ValueError) as error:
        raise MalformedMessageError(f"it is no reply message: {error}") from error
    return number, results


def _around_block(data: bytes | memoryview) -> Any:
    """A reply message that ends with a block, which is not copied; None where that is not sure.

    To copy 49 kB once more took longer than to unpack all the rest.
    """
    for size, header in _BLOCK_HEADERS:
        begin = len(data) - size
        before = begin - len(header)
        if before > 0 and data[before:begin] == header:
            try:
                # With nil in the block's place; what only looks like one is the end of something that lacks it then.
                message = msgpack.unpackb(bytes(data[:before]) + _NIL)
                last = message[1][-1]
            except (ValueError, TypeError, LookupError, RecursionError, msgpack.UnpackException):
                return None
            if not (type(last) is list and len(last) == 3 and last[2] is None):
                return None
            last[2] = memoryview(data)[begin:]
            return message
    return None


def _unpacked(data: bytes | memoryview) -> Any:
    try:
        return msgpack.unpackb(data)
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:
        if _ends_early(data):
            raise TruncatedMessageError(f"the message ends after {len(data)} bytes, before it is complete") from error
        raise MalformedMessageError(f"the message is no msgpack: {str(error)[:200] or type(error).__name__}") from error


def _ends_early(data: bytes | memoryview) -> bool:
    unpacker = msgpack.Unpacker(max_buffer_size=max(1, len(data)))
    unpacker.feed(data)
    try:
        unpacker.skip()
    except msgpack.OutOfData:
        return True
    except (ValueError, RecursionError, msgpack.UnpackException):
        return False
    return False
