"""What comes over the wire, turned into messages and arrays."""

from collections.abc import Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from wrongturn_client.errors import ProtocolError
from wrongturn_protocol import Track
from wrongturn_protocol.observations import FIELDS, Observation, decode

M = TypeVar("M", bound=BaseModel)
_TRACKS: Final = {frozenset(field.name for field in fields): track for track, fields in FIELDS.items()}


def track_of_message(observation: Mapping[str, Any]) -> Track:
    """Which track an observation is of, by its keys.

    Raises:
        ProtocolError: no track has just these keys.
    """
    track = _TRACKS.get(frozenset(observation))
    if track is None:
        raise ProtocolError(
            f"no track has observations of just {', '.join(sorted(observation))}; "
            "are the service and this client of the same version?",
        )
    return track


def decode_observation(message: Any) -> Observation:
    """The arrays of an observation in JSON or msgpack.

    Raises:
        ProtocolError: it is none.
    """
    if not isinstance(message, Mapping):
        raise ProtocolError(f"an observation must be an object, not {type(message).__name__}")
    try:
        return decode(message, track_of_message(message))
    except (ValueError, KeyError, TypeError) as error:
        raise ProtocolError(f"an observation cannot be read: {error}") from error


def decode_reply(message: Any) -> dict[str, Any]:
    """The reply to a reset or a step with its observation turned into arrays.

    Raises:
        ProtocolError: it is no such reply.
    """
    if not isinstance(message, dict) or "observation" not in message:
        raise ProtocolError("the answer has no observation; are the service and this client of the same version?")
    message["observation"] = decode_observation(message["observation"])
    return message


def validated(kind: type[M], message: Any) -> M:
    """Plain values as a message.

    Raises:
        ProtocolError: they are none.
    """
    try:
        # What model_validate calls, after it has looked at options that nobody gives here.
        found: M = kind.__pydantic_validator__.validate_python(message)
        return found
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ProtocolError(
            f"the answer is no {kind.__name__} ({where}: {first['msg']}); "
            "are the service and this client of the same version?",
        ) from error
