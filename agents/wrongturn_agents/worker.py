"""Worker that registers an agent, begins its evaluation on a suite and drives it to the end."""

import contextlib
import os
import secrets
from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from pydantic import ValidationError

from wrongturn_agents.agent import Agent
from wrongturn_agents.errors import AgentFailedError, AgentsError, RunError, RunOverError
from wrongturn_agents.progress import Progress
from wrongturn_agents.registry import AgentSource, with_absolute_file
from wrongturn_agents.saved_run import SavedRun, checksums, ensure_directory
from wrongturn_client import (
    AgentNameTakenError,
    ApiError,
    AuthenticationError,
    Client,
    ConflictError,
    LocalService,
    NotFoundError,
    OwnerNameTakenError,
    WrongturnError,
)
from wrongturn_client.local_service import FOR_ONE_COMMAND
from wrongturn_client.settings import OPERATOR_TOKEN, OWNER_TOKEN
from wrongturn_client.submitter import NAME_RULE
from wrongturn_protocol import (
    Action,
    AgentKind,
    EvaluationDetail,
    EvaluationState,
    ProblemType,
    RegisteredAgent,
    Rig,
    Track,
)
from wrongturn_protocol.answers import driver_of
from wrongturn_protocol.episodes import ActionError, action_error
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.rigs import rig_of


@contextlib.contextmanager
def service_at(
    url: str | None, operator_token: str | None, database: str | None = None
) -> Iterator[tuple[str, str | None]]:
    """Yield the URL and operator's token of a service.

    Without a URL, start one for the ``with`` block, with a database at this URL or the default one.
    """
    if url is not None:
        yield url, operator_token
        return
    own_token = operator_token or secrets.token_urlsafe(32)
    with LocalService(database=database, environment={**FOR_ONE_COMMAND, OPERATOR_TOKEN: own_token}) as service:
        yield service.url, own_token


def begin(
    agent: str,
    suite: str,
    source: AgentSource,
    url: str,
    *,
    operator_token: str | None = None,
    name: str | None = None,
    token: str | None = None,
    owner_token: str | None = None,
) -> SavedRun:
    """Register the agent, begin its evaluation and save what is needed to resume it.

    ``source`` is what ``agent`` names. With the operator's token, a baseline is registered as one; with an owner's, the
    agent becomes that owner's. With its own ``token``, it is registered already. The default name is its own.

    Raises:
        RunError: The name is taken or not valid, the owner's token is missing or not valid, or the suite does
            not have the agent's track.
        RunFileError: The run cannot be saved.
        WrongturnError: The service refuses, or cannot be reached.
    """
    ensure_directory()  # fails before a name is taken by a run that could not be resumed
    registered = None
    with Client(url, owner_token or operator_token) as client:
        found = client.suite(suite)
        if source.track not in found.tracks:
            raise RunError(
                f"suite: {found.id} is driven in the tracks {', '.join(found.tracks)}, "
                f"and {source.name} wants {source.track}; choose another suite or agent"
            )
        if token is None:
            kind = source.kind if operator_token and not owner_token else AgentKind.SUBMITTED
            registered = _register(client, name or source.name, source, kind, owned=owner_token is not None)
    with Client(url, registered.token if registered else token) as client:
        evaluation = client.create_evaluation(suite)
        if registered is None:
            _check_registered_track(client, evaluation, source)
    saved_run = SavedRun(
        agent=with_absolute_file(agent),
        name=registered and registered.name,
        suite=suite,
        evaluation=evaluation.id,
        token=registered.token if registered else str(token),
        url=url,
        code=checksums(source.code),
    )
    saved_run.save()
    return saved_run


def episodes_side_by_side(agent: Agent, wanted: int | None) -> int:
    """Return how many episodes an agent drives at once: without a memory one for each processor, else one.

    Raises RunError if more are wanted of an agent that does not say ``memoryless``.
    """
    if getattr(agent, "memoryless", False) is True:
        return wanted or len(os.sched_getaffinity(0))
    if wanted is not None and wanted > 1:
        raise RunError("--parallel: the agent may keep a memory between steps; leave it out, or set memoryless = True")
    return 1


def drive(
    saved_run: SavedRun, source: AgentSource, url: str, progress: Progress, *, parallel: int | None = None
) -> EvaluationDetail:
    """Drive an evaluation to its end, from wherever it is.

    ``progress`` is called after each episode; ``parallel`` is as in :func:`episodes_side_by_side`.

    Raises:
        RunOverError: The evaluation was ended or deleted, or its token was revoked. The run cannot be resumed.
        AgentFailedError: The agent failed. The episode counts as aborted, and the run can be resumed.
        WrongturnError: The service refuses, or cannot be reached any more. The run can be resumed.
    """
    agent = source.make()
    with Client(url, saved_run.token) as client:
        try:
            return client.evaluate(
                GuardedAgent(source.name, agent),
                saved_run.suite,
                evaluation=saved_run.evaluation,
                progress=progress,
                parallel=episodes_side_by_side(agent, parallel),
            )
        except (AuthenticationError, NotFoundError, ConflictError) as error:
            why = _why_over(client, saved_run.evaluation, error)
            if why is None:
                raise
            raise RunOverError(f"{why}; it cannot be resumed") from error


def _why_over(client: Client, evaluation: str, error: ApiError) -> str | None:
    """Return why an evaluation cannot be driven on after an error; None if it can, or nobody knows."""
    if error.type == ProblemType.UNAUTHENTICATED:
        return (
            f"{client.url} does not take the token of evaluation {evaluation} any more: its owner or the operator has "
            "ended the token or deleted the agent"
        )
    try:
        state = client.evaluation(evaluation).state
    except NotFoundError:
        return f"{client.url} has no evaluation {evaluation} any more: its owner or the operator has deleted it"
    except WrongturnError:
        return None
    if state is EvaluationState.RUNNING:
        return None
    return f"evaluation {evaluation} is {state}: its owner, the operator or the service has ended it early"


def _register(client: Client, name: str, source: AgentSource, kind: AgentKind, *, owned: bool) -> RegisteredAgent:
    """Register the agent, with the owner's token if it is to be owned."""
    try:
        return client.register(
            name,
            source.track,
            description=source.description or None,
            kind=kind,
            trained_on_faults=source.trained_on_faults,
            rig=source.rig,
        )
    except ValueError as error:
        if not isinstance(error.__cause__, ValidationError):
            raise
        raise RunError(_registration_error(error.__cause__, name)) from error
    except AuthenticationError as error:
        if owned:
            raise RunError(f"{OWNER_TOKEN}: {client.url} does not take it: {error}") from error
        if error.type == ProblemType.REGISTRATION_CLOSED:
            raise RunError(
                f"{OWNER_TOKEN}: {client.url} registers agents only for owners; ask its operator for a token"
            ) from error
        raise
    except (AgentNameTakenError, OwnerNameTakenError) as error:
        raise RunError(
            f"--name: {name!r} is taken at {client.url}; choose another name, or go on with an agent of yours by its "
            "token in WRONGTURN_TOKEN. A new model is a new agent: its first evaluation on a suite is the one that "
            "counts"
        ) from error


def _registration_error(error: ValidationError, name: str) -> str:
    first = error.errors(include_url=False)[0]
    field = ".".join(map(str, first["loc"]))
    if field == "name":
        return f"--name: {name!r} cannot be a name; {NAME_RULE}"
    return f"agent: its {field} cannot be registered: {first['msg']}"


def _check_registered_track(client: Client, evaluation: EvaluationDetail, source: AgentSource) -> None:
    """Check that the agent was registered for the track that it wants now; if not, cancel the evaluation."""
    with contextlib.suppress(NotFoundError):
        registered = client.agent(evaluation.agent)
        if registered.track is not source.track or registered.rig != source.rig:
            client.cancel_evaluation(evaluation.id)
            what = "another rig" if registered.track is source.track else f"the track {registered.track}"
            raise RunError(
                f"WRONGTURN_TOKEN: it is the token of {registered.name}, registered for {what}, "
                f"and {source.name} wants {'its own' if registered.track is source.track else source.track}; "
                "unset it to register anew"
            )


class GuardedAgent:
    """Agent whose own failures raise AgentFailedError, so that they differ from the service's."""

    def __init__(self, name: str, agent: Agent) -> None:
        self._name, self._agent = name, agent
        self.rig: Rig | None = rig_of(getattr(agent, "rig", None))
        """Its rig; None: what its track shows."""
        self._control = driver_of(self.rig or Track.STATE)
        follows = self.rig is not None and self.rig.action.kind != "controls"
        self.memoryless = getattr(agent, "memoryless", False) is True and not follows
        """Whether an action depends on the observation alone."""
        self.takes_batches = self.memoryless and callable(getattr(agent, "act_batch", None))
        """Whether the agent takes the observations of several episodes at once."""

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Call the agent's ``reset``."""
        with self._guard("reset"):
            self._agent.reset(observation_space)
        self._control = driver_of(self.rig or Track.STATE)

    def act(self, observation: Observation) -> Action:
        """Call the agent's ``act``. It has to return an action that can be driven."""
        with self._guard("act"):
            given: object = self._agent.act(observation)
        return self._action(given, "act", observation)

    def act_batch(self, observations: Sequence[Observation]) -> list[Action]:
        """Call ``act_batch`` of an agent that has it with some observations, stacked; return an action for each."""
        stacked = {key: np.stack([one[key] for one in observations]) for key in observations[0]}
        with self._guard("act_batch"):
            given: list[object] = list(cast(Any, self._agent).act_batch(stacked))
        if len(given) != len(observations):
            raise AgentFailedError(
                f"agent: {self._name}.act_batch returned {len(given)} actions for {len(observations)} observations"
            )
        return [self._action(one, "act_batch", seen) for one, seen in zip(given, observations, strict=True)]

    def _action(self, given: object, method: str, observation: Observation) -> Action:
        try:
            return self._control(given, observation)
        except ActionError as error:
            called = f"agent: {self._name}.{method}"
            raise AgentFailedError(f"{called} returned no action that can be driven: {error}") from None

    @contextlib.contextmanager
    def _guard(self, method: str) -> Iterator[None]:
        try:
            yield
        except AgentsError:
            raise
        except Exception as error:
            called = f"agent: {self._name}.{method}"
            if isinstance(error, ActionError):
                raise AgentFailedError(f"{called} made no action: {error}") from None
            if isinstance(error, ValidationError) and error.title == Action.__name__:
                raise AgentFailedError(f"{called} made no action: {action_error(error)}") from None
            raise AgentFailedError(f"{called} raised {type(error).__name__}: {error}") from error
