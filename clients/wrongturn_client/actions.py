"""Actions as agents give them, and errors in them in one line for the agent's author."""

from typing import Final

from pydantic import ValidationError

from wrongturn_client.errors import InvalidActionError
from wrongturn_protocol import Action
from wrongturn_protocol.actions import three_numbers

_RANGES: Final = {"steer": "-1 to 1", "throttle": "0 to 1", "brake": "0 to 1"}


def action_error(error: ValidationError) -> str:
    """Return the first error in the values of an :class:`wrongturn_protocol.Action`, in one line."""
    first = error.errors(include_url=False)[0]
    field = str(first["loc"][0])
    if field not in _RANGES:
        return f"action.{field}: there is no such field; give steer, throttle and brake"
    given = "missing" if first["type"] == "missing" else repr(first["input"])
    return f"action.{field} is {given}; give a number from {_RANGES[field]}"


def is_of_action(error: ValidationError) -> bool:
    """Tell whether an error comes from making an :class:`wrongturn_protocol.Action`."""
    return error.title == Action.__name__


def action_of(given: object) -> Action:
    """Return what an agent gave as an action that can be driven.

    Args:
        given: An :data:`~wrongturn_protocol.ActionLike`: an Action, or three numbers in an array, a tuple or a list.

    Raises:
        InvalidActionError: It is not three numbers, or one is out of range.
    """
    try:
        if isinstance(given, Action):  # checked again, because model_construct and model_copy check nothing
            return Action(given.steer, given.throttle, given.brake)
        return Action(*three_numbers(given, InvalidActionError))
    except ValidationError as error:
        raise InvalidActionError(action_error(error)) from None
