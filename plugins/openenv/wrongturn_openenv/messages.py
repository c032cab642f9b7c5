"""OpenEnv's messages, as its version 0.3 sends them: what a client asks for and what it is answered."""

import contextlib
import json
from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any, Final, Literal

from gymnasium.error import ResetNeeded
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wrongturn_client.errors import WrongturnError
from wrongturn_protocol import Action, Fault, Track
from wrongturn_protocol.episodes import action_error
from wrongturn_protocol.suggestions import did_you_mean

_SHOWN: Final = 40
_SEED: Final = "Seed of the trials that are drawn from now on. Without it, the next trial is drawn."


class ErrorCode(StrEnum):
    """Code of an error, of OpenEnv's list."""

    INVALID_JSON = "INVALID_JSON"
    UNKNOWN_TYPE = "UNKNOWN_TYPE"
    VALIDATION_ERROR = "VALIDATION_ERROR"
    EXECUTION_ERROR = "EXECUTION_ERROR"
    CAPACITY_REACHED = "CAPACITY_REACHED"


class RefusedError(Exception):
    """The server refuses a message. The session stays open."""

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code


class ResetRequest(BaseModel):
    """The parameters of a reset. One that is left out has the value with which the server was started."""

    model_config = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)

    seed: Annotated[int | None, Field(ge=0, description=_SEED)] = None
    episode_id: Annotated[str | None, Field(max_length=255)] = None
    """The ``episode_id`` of the state; by default the service's id of the episode."""
    town: str | None = None
    """The town to draw trials in."""
    track: str | None = None
    """What the observation holds: ``state``, ``camera``, ``segmentation`` or ``privileged``."""
    approach: str | None = None
    """The approach by which all trials drive in, such as ``J3-S``."""
    fault: str | Fault | None = None
    """What is done to the command, such as ``infeasible``."""
    task: str | None = None
    """Draw journeys of this task, such as ``navigation``, instead of single junctions."""
    route: int | None = None
    """The direction of the routes: 1 left, 2 right, 3 straight."""
    weather: str | list[str] | None = None
    """The weather, or several to draw from."""
    traffic: dict[str, int] | None = None
    """The other road users, such as ``{"vehicles": 20, "pedestrians": 10}``."""
    suite: str | None = None
    """Draw among this suite's trials instead."""
    trial: str | None = None
    """The trial of the suite to drive."""


class StepRequest(BaseModel):
    """The body of ``POST /step``."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    action: dict[str, Any]
    """Steer, throttle and brake."""


class Reply(BaseModel):
    """The answer to a reset and to a step."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    observation: dict[str, Any]
    """The observation, with the keys of ``docs/observations.md``."""
    reward: float | None = None
    """The reward of the step; None after a reset."""
    done: bool = False
    """Whether the episode is over; the state says how."""


class State(BaseModel):
    """What a client can ask about its episode, beside the observation."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    episode_id: str | None = None
    """The name that the reset gave, or else the service's id; None before the first reset."""
    step_count: int = 0
    """Steps of 0.1 s since the reset."""
    track: Track | None = None
    """The track of the observation."""
    town: str | None = None
    """The town of the trial."""
    trial: str | None = None
    """Id of the trial."""
    terminated: bool = False
    """Whether a verdict ended the episode."""
    truncated: bool = False
    """Whether time ran out, or the service gave the episode up."""
    verdict: str | None = None
    """How the episode ended, such as ``exit_commanded``."""
    lost: str | None = None
    """Why the service gave the episode up, if it did."""


class Message(BaseModel):
    """A message of a client over the WebSocket."""

    model_config = ConfigDict(extra="forbid")

    type: Literal["reset", "step", "state", "close"]
    data: dict[str, Any] = {}


def read(text: str) -> Message:
    """Return a message of a client; raise RefusedError if it is none of OpenEnv's."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RefusedError(ErrorCode.INVALID_JSON, f"the message is no JSON: {str(error)[:200]}") from None
    if not isinstance(found, dict):
        raise RefusedError(ErrorCode.VALIDATION_ERROR, "the message is not an object; send one with type and data")
    with refusals():
        return Message.model_validate(found)


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """Turn the errors of messages and of the environment into refusals."""
    try:
        yield
    except ValidationError as error:
        unknown = error.title == Message.__name__ and error.errors()[0]["loc"] == ("type",)
        code = ErrorCode.UNKNOWN_TYPE if unknown else ErrorCode.VALIDATION_ERROR
        said = action_error(error) if error.title == Action.__name__ else _first_error(error)
        raise RefusedError(code, said) from None
    except ValueError as error:
        raise RefusedError(ErrorCode.VALIDATION_ERROR, str(error)) from None
    except (WrongturnError, ResetNeeded) as error:
        raise RefusedError(ErrorCode.EXECUTION_ERROR, str(error)) from None


def action_of(data: dict[str, Any]) -> Action:
    """Return the action of a step, without the ``metadata`` that OpenEnv's typed clients send; raise RefusedError."""
    with refusals():
        return Action.model_validate({name: value for name, value in data.items() if name != "metadata"})


def _first_error(error: ValidationError) -> str:
    """Return the first error in a client's data in one line."""
    first = error.errors(include_url=False)[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden" and error.title == ResetRequest.__name__:
        known = ResetRequest.model_fields
        return f"{name}: a reset has no such parameter; give {', '.join(known)}{did_you_mean(name, known)}"
    return f"{name}: is {str(first['input'])[:_SHOWN]!r}; {first['msg'][0].lower()}{first['msg'][1:]}"
