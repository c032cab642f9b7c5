"""Replies of the service as messages and arrays."""

from collections.abc import Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from wrongturn_client.errors import ProtocolError
from wrongturn_protocol import Track
from wrongturn_protocol.observations import FIELDS, Observation, decode

M = TypeVar("M", bound=BaseModel)
_TRACKS: Final = {frozenset(field.name for field in fields): track for track, fields in FIELDS.items()}


def track_of_message(observation: Mapping[str, Any]) -> Track:
    """Return the track of an observation, by its keys; raise ProtocolError if no track has exactly these."""
    track = _TRACKS.get(frozenset(observation))
    if track is None:
        raise ProtocolError(
            f"no track has observations of just {', '.join(sorted(observation))}; "
            "are the service and this client of the same version?"
        )
    return track


def decode_observation(message: Any) -> Observation:
    """Return the arrays of an observation in JSON or msgpack; raise ProtocolError if it is none."""
    if not isinstance(message, Mapping):
        raise ProtocolError(f"an observation must be an object, not {type(message).__name__}")
    try:
        return decode(message, track_of_message(message))
    except (ValueError, KeyError, TypeError) as error:
        raise ProtocolError(f"an observation cannot be read: {error}") from error


def decode_reply(message: Any) -> dict[str, Any]:
    """Return the reply to a reset or a step, with its observation as arrays; raise ProtocolError if it is none."""
    if not isinstance(message, dict) or "observation" not in message:
        raise ProtocolError("the answer has no observation; are the service and this client of the same version?")
    message["observation"] = decode_observation(message["observation"])
    return message


def validated(kind: type[M], message: Any) -> M:
    """Return plain values as a message of this kind; raise ProtocolError if they are none."""
    try:
        # model_validate does the same, but first looks at options that are not given here.
        found: M = kind.__pydantic_validator__.validate_python(message)
        return found
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ProtocolError(
            f"the answer is not a valid {kind.__name__} ({where}: {first['msg']}); "
            "are the service and this client of the same version?"
        ) from error
