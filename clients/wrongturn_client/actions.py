"""Errors in actions, in one line for the agent's author."""

from typing import Final

from pydantic import ValidationError

from wrongturn_protocol import Action

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


def refusal(action: object) -> str | None:
    """Return why ``act`` may not return this value, in words that follow "act"; None if it may."""
    if not isinstance(action, Action):
        return f"returned {type(action).__name__}; return a wrongturn_client.Action"
    try:
        # Checked again, because model_construct and model_copy check nothing.
        Action(steer=action.steer, throttle=action.throttle, brake=action.brake)
    except ValidationError as error:
        return f"returned no action that can be driven: {action_error(error)}"
    return None
