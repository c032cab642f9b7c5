"""The calls that drive an episode, and their replies. A WebSocket, HTTP and the client itself all answer them."""

import threading
import uuid
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from wrongturn_client.closing import Closing
from wrongturn_client.errors import ApiError, InvalidActionError, PolicyError, ProtocolError, WrongturnError
from wrongturn_protocol import Action, ActionLike, EpisodeDetail, EpisodeReply, PracticeRequest, StepReply, Track
from wrongturn_protocol.actions import three_numbers
from wrongturn_protocol.episodes import ActionError
from wrongturn_protocol.observations import FIELDS, Observation, decode, decode_rig, fields_of
from wrongturn_protocol.rigs import RigError, Sight, rig_of
from wrongturn_protocol.wire import Call

M = TypeVar("M", bound=BaseModel)
EpisodeCall = Sequence[Any]
"""A call such as ``["step", episode, seq, steer, throttle, brake]``; see :mod:`wrongturn_protocol.wire`."""
Result = dict[str, Any] | ApiError
"""The fields of the reply with the observation as arrays, or the service's refusal."""
_STEP: Final = Call.STEP.value
_TRACKS: Final = {frozenset(field.name for field in fields): track for track, fields in FIELDS.items()}
_SAME_VERSION: Final = "are the service and this client of the same version?"


def action_of(given: object) -> Action:
    """Return what an agent gave as an action that can be driven; raise InvalidActionError if it is none."""
    try:
        if isinstance(given, Action):  # checked again, because model_construct and model_copy check nothing
            return Action(given.steer, given.throttle, given.brake)
        return Action(*three_numbers(given, InvalidActionError))
    except ActionError as error:
        raise InvalidActionError(str(error)) from None


def step_call(episode: str, seq: int, action: ActionLike) -> list[Any]:
    """Return the call of a step; raise InvalidActionError if the action is not one."""
    if not isinstance(action, Action):
        action = action_of(action)
    return [_STEP, episode, seq, action.steer, action.throttle, action.brake]


def next_call(evaluation: str) -> list[Any]:
    """Return the call that begins the next trial; if you send it twice, both replies name the same episode."""
    return [Call.NEXT.value, evaluation, str(uuid.uuid4())]


def practise_call(request: PracticeRequest, key: str | None = None) -> list[Any]:
    """Return the call that begins a practice episode; if you send it twice, both replies name the same episode."""
    body = request.model_dump(mode="json", exclude_none=True)
    return [Call.PRACTISE.value, body, key or str(uuid.uuid4())]


def granted(result: Result) -> dict[str, Any]:
    """Return the fields of a result, or raise its ApiError."""
    if isinstance(result, ApiError):
        raise result
    return result


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
            f"the answer is not a valid {kind.__name__} ({where}: {first['msg']}); {_SAME_VERSION}"
        ) from error


def shown_track(observation: Observation) -> Track | None:
    """Return the track whose arrays these are, by names and shapes; None for those of a rig."""
    track = _TRACKS.get(frozenset(observation))
    alike = track is not None and all(observation[field.name].shape == field.shape for field in FIELDS[track])
    return track if alike else None


def decoded(message: Mapping[str, Any]) -> Observation:
    """Return the arrays of an observation in JSON or msgpack, of a track or a rig. Raises ValueError."""
    track = _TRACKS.get(frozenset(message))
    shapes = {field.name: list(field.shape) for field in FIELDS[track] if field.image} if track is not None else {}
    if track is None or any(list(message[name]["shape"]) != shape for name, shape in shapes.items()):
        return decode_rig(message)
    return decode(message, track)


def sight_of_policy(policy: object, observation: Observation) -> Sight:
    """Return what a policy is shown: its ``rig``, or the track of an observation.

    Raises:
        PolicyError: The policy's rig is none, or the agent was registered with another one.
    """
    try:
        rig = rig_of(getattr(policy, "rig", None))
    except RigError as error:
        raise PolicyError(f"{type(policy).__name__}.{error}") from None
    if rig is None:
        if (track := shown_track(observation)) is None:
            raise PolicyError(
                f"{type(policy).__name__}.rig: there is none, and the agent was registered with one, which shows "
                f"{', '.join(observation)}; give the class that rig, or register the agent anew without one"
            )
        return track
    fields = {field.name: field.shape for field in fields_of(rig)}
    shapes = {name: array.shape for name, array in observation.items()}
    if shapes != fields:
        wrong = next(name for name in (*fields, *shapes) if fields.get(name) != shapes.get(name))
        raise PolicyError(
            f"{type(policy).__name__}.rig: {wrong} is {fields.get(wrong, 'not in it')}, and the service shows "
            f"{shapes.get(wrong, 'none')}; the agent was registered with another rig: register it anew with this one"
        )
    return rig


class OneThread:
    """Context in which one thread uses an environment or a connection; it may enter it again.

    Two threads would take each other's replies, or drive the same step. Another thread gets a WrongturnError.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise WrongturnError(
                "an environment or connection is used by two threads at a time; make one for each thread, or take turns"
            )

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type["OneThread"], tuple[()]]:
        """Pickle what holds this: in another process nobody is inside."""
        return OneThread, ()


class EpisodeCalls(Closing):
    """Base of what drives episodes: each call as a method with typed arguments and replies."""

    @abstractmethod
    def _answer(self, call: EpisodeCall) -> Result:
        """Send one call and return its result."""

    def next_episode(self, evaluation: str) -> EpisodeReply:
        """Begin the next trial of an evaluation (the reset).

        Raises:
            EvaluationFinishedError: No trial is left.
            NoTrialAvailableError: No trial is free now; ``retry_after`` says when to ask again.
        """
        return self._model(EpisodeReply, next_call(evaluation))

    def practise(self, request: PracticeRequest, *, key: str | None = None) -> EpisodeReply:
        """Begin a practice episode, which is never scored (the reset).

        Calls with the same ``key`` return the same episode; by default each key is new.
        """
        return self._model(EpisodeReply, practise_call(request, key))

    def step(self, episode: str, seq: int, action: ActionLike) -> StepReply:
        """Drive an episode for 0.1 s; ``seq`` is that of the last reply, plus 1.

        The action is an Action, or steer, throttle and brake in an array, a tuple or a list.

        Raises:
            InvalidActionError: The action is not three numbers in their ranges.
            EpisodeFinishedError: The episode is over.
            EpisodeLostError: The service was restarted while the episode was open.
        """
        return self._model(StepReply, step_call(episode, seq, action))

    def episode(self, episode: str) -> EpisodeDetail:
        """Return an episode: its last reply while it is open, its outcome once it may be shown."""
        return self._model(EpisodeDetail, [Call.LOOK.value, episode])

    def abort_episode(self, episode: str) -> None:
        """End an episode. A scored one then counts as ``aborted``, which is unsafe."""
        granted(self._answer([Call.ABORT.value, episode]))

    def _model(self, kind: type[M], call: EpisodeCall) -> M:
        return validated(kind, granted(self._answer(call)))


class DriveConnection(EpisodeCalls):
    """Connection for driving many episodes: several calls go in one message.

    One thread may use it at a time; another one gets a WrongturnError.
    """

    def __init__(self, patience: float) -> None:
        self.patience = patience
        """Seconds for which calls are repeated while the service is busy or does not answer; 0 for never."""
        self._alone = OneThread()

    @abstractmethod
    def exchange(self, calls: Sequence[EpisodeCall]) -> list[Result]:
        """Send a message of 1 to 256 calls and return their results. Calls that meet a busy service are repeated.

        After an error you can send the same calls again: none has its effect twice.

        Raises:
            ServiceUnreachableError: Nobody answered within the patience.
            ApiError: The service refused the connection.
        """

    def steps(self, steps: Sequence[tuple[str, int, ActionLike]]) -> list[StepReply | ApiError]:
        """Drive several episodes for 0.1 s in one message; return a reply or an error for each.

        Each step is given as the arguments of :meth:`step`: episode, seq and action.
        """
        results = self.exchange([step_call(*step) for step in steps])
        return [result if isinstance(result, ApiError) else validated(StepReply, result) for result in results]

    def _answer(self, call: EpisodeCall) -> Result:
        return self.exchange([call])[0]
