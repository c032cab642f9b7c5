"""Encodings of replies to resets and steps: JSON, msgpack, or raw arrays.

A simulator process encodes the observation. The web process inserts its bytes between the other fields and never
decodes it.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import msgpack
import orjson

from wrongturn_protocol import Rig, Sight, Verdict
from wrongturn_protocol.wire import result_head

if TYPE_CHECKING:
    from collections.abc import Mapping


class Encoding(StrEnum):
    """An encoding and its media type."""

    JSON = "application/json"
    MSGPACK = "application/msgpack"
    RAW = "application/vnd.wrongturn.result"
    """A result of ``WS /v1/drive``, see :mod:`wrongturn_protocol.wire`. Not available over HTTP."""


@dataclass(slots=True)
class Reply:
    """The reply to a reset or a step: fields before the encoded observation, and after it.

    Do not change it; it is not frozen because that would cost time in every step.
    """

    seq: int
    observation: bytes
    encoding: Encoding
    sight: Sight
    head: tuple[tuple[str, object], ...]
    tail: tuple[tuple[str, object], ...]

    def render(self, encoding: Encoding) -> bytes:
        """Return the reply's body in an encoding."""
        observation = self.observation
        if encoding is not self.encoding:
            observation = _transcode(observation, self.sight, self.encoding, encoding)
        if encoding is Encoding.RAW:
            return b"".join(self._raw(observation))
        if encoding is Encoding.JSON:
            head, tail = orjson.dumps(dict(self.head)), orjson.dumps(dict(self.tail))
            return b"".join((head[:-1], _OBSERVATION_JSON, observation, b",", tail[1:]))
        # The first byte of a map counts its pairs; the rest are these.
        pairs = len(self.head) + 1 + len(self.tail)
        head, tail = msgpack.packb(dict(self.head)), msgpack.packb(dict(self.tail))
        return b"".join((bytes([_MAP | pairs]), head[1:], _OBSERVATION_MSGPACK, observation, tail[1:]))

    def pieces(self) -> tuple[bytes, bytes]:
        """Return the result for ``WS /v1/drive`` in two pieces. The second is the observation, not copied."""
        if self.encoding is not Encoding.RAW:
            return self._raw(_transcode(self.observation, self.sight, self.encoding, Encoding.RAW))
        return self._raw(self.observation)

    def _raw(self, observation: bytes) -> tuple[bytes, bytes]:
        # A reset's reply begins with the episode's id.
        status = 201 if self.head[0][0] == "id" else 200
        return result_head(status, dict(self.head + self.tail), len(observation)), observation


def reset_reply(
    episode: str,
    observation: bytes,
    encoding: Encoding,
    sight: Sight,
    *,
    town: str | None,
    trial: str | None,
    lease_s: float,
) -> Reply:
    """Return the reply to a reset. It leaves out town and trial if they are None."""
    tail: list[tuple[str, object]] = [("lease_expires_in_s", lease_s)]
    tail += [(key, value) for key, value in (("town", town), ("trial", trial)) if value is not None]
    return Reply(0, observation, encoding, sight, (("id", episode), ("seq", 0)), tuple(tail))


def step_reply(
    seq: int,
    observation: bytes,
    encoding: Encoding,
    sight: Sight,
    *,
    terminated: bool,
    truncated: bool,
    reward: float | None,
    verdict: Verdict | None,
) -> Reply:
    """Return the reply to a step. It leaves out reward and verdict if they are None."""
    tail: tuple[tuple[str, object], ...] = (("terminated", terminated), ("truncated", truncated))
    if reward is not None:
        tail += (("reward", reward),)
    if verdict is not None:
        tail += (("verdict", verdict.value),)
    return Reply(seq, observation, encoding, sight, (("seq", seq),), tail)


_OBSERVATION_JSON: Final = b',"observation":'
_OBSERVATION_MSGPACK: Final = msgpack.packb("observation")
_MAP: Final = 0x80
"""First byte of a map of msgpack, with the number of its pairs: at most 15."""


def _transcode(observation: bytes, sight: Sight, source: Encoding, encoding: Encoding) -> bytes:
    # Rare: a reply is asked for again in another encoding. Only then numpy and gymnasium are imported.
    from wrongturn_protocol import observations, wire  # noqa: PLC0415

    unpack = orjson.loads if source is Encoding.JSON else msgpack.unpackb
    if isinstance(sight, Rig):
        return encoded(observations.decode_rig(unpack(observation), compressed=True), sight, encoding)
    if source is Encoding.RAW:
        return encoded(wire.arrays(observation), sight, encoding)
    return encoded(observations.decode(unpack(observation), sight), sight, encoding)


def encoded(observation: "Mapping[str, Any]", sight: Sight, encoding: Encoding) -> bytes:
    """Encode an observation's arrays."""
    from wrongturn_protocol import observations, wire  # noqa: PLC0415

    if encoding is Encoding.RAW:
        return wire.block(observation, sight)
    binary = encoding is Encoding.MSGPACK
    message = observations.encode(observation, sight, binary=binary)
    packed: bytes = msgpack.packb(message) if binary else orjson.dumps(message)
    return packed
