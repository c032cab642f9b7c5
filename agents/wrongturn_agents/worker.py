"""The worker: puts one agent on one suite of a service and sees it through."""

import contextlib
import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

from gymnasium import spaces
from pydantic import ValidationError

from wrongturn_agents.agent import Agent
from wrongturn_agents.errors import AgentFailedError, AgentsError, RunError
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.saved_run import SavedRun, ensure_directory
from wrongturn_client import AgentNameTakenError, Client, LocalService, NotFoundError
from wrongturn_client.actions import action_error, is_of_action, refusal
from wrongturn_protocol import Action, AgentKind, EvaluationDetail, RegisteredAgent
from wrongturn_protocol.observations import Observation

_NAMES_TRIED: Final = 100
OPERATOR_TOKEN: Final = "WRONGTURN_OPERATOR_TOKEN"  # noqa: S105 - the variable's name
"""The environment variable whose token lets baselines be called so."""

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all episodes."""


@dataclass(frozen=True)
class RunRequest:
    """What to run, and where."""

    agent: str
    """A registered name, ``package.module:Class`` or an ``.onnx`` file."""
    suite: str
    url: str | None = None
    """Of the service; None for one of the worker's own."""
    name: str | None = None
    """On the leaderboard; None for the agent's own, numbered where that is taken."""
    token: str | None = None
    """Of an agent that is registered already; None to register it."""
    operator_token: str | None = None
    """Lets an agent be registered as what it says it is, such as a baseline."""


@contextlib.contextmanager
def service_at(url: str | None, operator_token: str | None) -> Iterator[tuple[str, str | None]]:
    """The URL and the operator's token of a service: the one that is named, or one's own as long as the block lasts."""
    if url is not None:
        yield url, operator_token
        return
    own_token = operator_token or secrets.token_urlsafe(32)
    with LocalService(environment={OPERATOR_TOKEN: own_token}) as service:
        yield service.url, own_token


def begin(request: RunRequest, source: AgentSource, url: str, operator_token: str | None) -> SavedRun:
    """Register the agent, begin its evaluation and note how to go on with it.

    Raises:
        RunError: the name is taken or cannot be one, or the suite does not have the agent's track.
        RunFileError: the note cannot be written.
        WrongturnError: the service refuses, or cannot be reached.
    """
    ensure_directory()  # before a name is taken that the run could not be gone on with
    with Client(url, operator_token) as client:
        suite = client.suite(request.suite)
        if source.track not in suite.tracks:
            raise RunError(
                f"suite: {suite.id} is driven in the tracks {', '.join(suite.tracks)}, "
                f"and {source.name} wants {source.track}; choose another suite or agent",
            )
        token, name = request.token, None
        if token is None:
            registered = _register(client, request, source, operator_token)
            token, name = registered.token, registered.name
    with Client(url, token) as client:
        evaluation = client.create_evaluation(request.suite)
        if request.token is not None:
            _same_track(client, evaluation, source)
    agent = str(Path(request.agent).resolve()) if request.agent.endswith(".onnx") else request.agent
    saved_run = SavedRun(
        agent=agent,
        name=name,
        suite=request.suite,
        evaluation=evaluation.id,
        token=token,
        url=request.url,
    )
    saved_run.save()
    return saved_run


def side_by_side(agent: Agent, wanted: int | None) -> int:
    """How many episodes an agent drives at a time: by default one for each processor if it keeps no memory, else one.

    Raises:
        RunError: several are wanted of an agent that does not say that it keeps none.
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

    Args:
        saved_run: which one.
        source: the agent.
        url: of the service.
        progress: told after each episode.
        parallel: episodes at a time; by default as :func:`side_by_side`.

    Raises:
        RunError: as :func:`side_by_side`.
        AgentFailedError: the agent raised something; the episode counts as aborted, and the run can be resumed.
        WrongturnError: the service refuses, or cannot be reached any more; the run can be resumed.
    """
    agent = source.make()
    policy = GuardedAgent(source.name, agent)
    with Client(url, saved_run.token) as client:
        return client.evaluate(
            policy,
            saved_run.suite,
            evaluation=saved_run.evaluation,
            progress=progress,
            parallel=side_by_side(agent, parallel),
        )


def _register(
    client: Client,
    request: RunRequest,
    source: AgentSource,
    operator_token: str | None,
) -> RegisteredAgent:
    kind = source.kind if operator_token else AgentKind.SUBMITTED
    for number in count(1):
        name = request.name or (source.name if number == 1 else f"{source.name}-{number}")
        try:
            return client.register(name, source.track, description=source.description or None, kind=kind)
        except ValidationError as error:
            raise RunError(_what_cannot_be_registered(error, name)) from error
        except AgentNameTakenError as error:
            if request.name is not None:
                raise RunError(f"--name: {name!r} is taken at {client.url}; choose another") from error
            if number >= _NAMES_TRIED:
                raise RunError(
                    f"--name: {source.name} to {name} are all taken at {client.url}; give one yourself",
                ) from error
    raise AssertionError("count() has no end")


def _what_cannot_be_registered(error: ValidationError, name: str) -> str:
    first = error.errors(include_url=False)[0]
    field = ".".join(map(str, first["loc"]))
    if field == "name":
        return (
            f"--name: {name!r} cannot be a name; give at most 64 letters, digits, spaces, dots, dashes and "
            "underscores, a letter or digit first"
        )
    return f"agent: its {field} cannot be registered: {first['msg']}"


def _same_track(client: Client, evaluation: EvaluationDetail, source: AgentSource) -> None:
    """An agent that was registered before may have been so for another track."""
    with contextlib.suppress(NotFoundError):
        registered = client.agent(evaluation.agent)
        if registered.track is not source.track:
            client.cancel_evaluation(evaluation.id)
            raise RunError(
                f"WRONGTURN_TOKEN: it is the token of {registered.name}, registered for the track {registered.track}, "
                f"and {source.name} wants {source.track}; unset it to register anew",
            )


class GuardedAgent:
    """Passes the two calls on, so that an agent's own mistake is told from the service's."""

    def __init__(self, name: str, agent: Agent) -> None:
        self._name, self._agent = name, agent

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """As the agent's; raises AgentFailedError."""
        try:
            self._agent.reset(observation_space)
        except AgentsError:
            raise
        except Exception as error:
            raise AgentFailedError(f"agent: {self._name}.reset raised {type(error).__name__}: {error}") from error

    def act(self, observation: Observation) -> Action:
        """As the agent's; raises AgentFailedError, also for what is no action."""
        try:
            action: object = self._agent.act(observation)
        except AgentsError:
            raise
        except Exception as error:
            if isinstance(error, ValidationError) and is_of_action(error):
                raise AgentFailedError(f"agent: {self._name}.act made no action: {action_error(error)}") from None
            raise AgentFailedError(f"agent: {self._name}.act raised {type(error).__name__}: {error}") from error
        why = refusal(action)
        if why is not None:
            raise AgentFailedError(f"agent: {self._name}.act {why}")
        assert isinstance(action, Action)
        return action
