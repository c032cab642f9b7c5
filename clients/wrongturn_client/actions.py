"""Actions as agents give them, and errors in them in one line for the agent's author."""

from pydantic import ValidationError

from wrongturn_client.errors import InvalidActionError
from wrongturn_protocol import Action
from wrongturn_protocol.actions import three_numbers
from wrongturn_protocol.episodes import ActionError


def is_of_action(error: ValidationError) -> bool:
    """Tell whether an error comes from making an :class:`wrongturn_protocol.Action`."""
    return error.title == Action.__name__


def action_of(given: object) -> Action:
    """Return what an agent gave as an action that can be driven; raise InvalidActionError if it is none."""
    try:
        if isinstance(given, Action):  # checked again, because model_construct and model_copy check nothing
            return Action(given.steer, given.throttle, given.brake)
        return Action(*three_numbers(given, InvalidActionError))
    except ActionError as error:
        raise InvalidActionError(str(error)) from None
