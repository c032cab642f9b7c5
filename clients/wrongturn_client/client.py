"""The calls of a Wrongturn service, each a method."""

import re
import uuid
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

import httpx
from pydantic import BaseModel

from wrongturn_client import settings
from wrongturn_client.decoding import validated
from wrongturn_client.drive import Drive
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, EpisodeCalls, Result
from wrongturn_client.errors import ApiError, NotOfferedError, WrongturnError
from wrongturn_client.evaluation_driver import EvaluationDriver
from wrongturn_client.http_drive import HttpCalls, HttpDrive
from wrongturn_client.policy import Policy
from wrongturn_client.recorder import EpisodeRecorder, installed_versions
from wrongturn_client.transport import JSON, MSGPACK, Reply, Transport, path_of
from wrongturn_protocol import (
    AgentDetail,
    AgentKind,
    AgentList,
    AgentRegistration,
    EpisodeDetail,
    EpisodeList,
    EpisodeRecord,
    EvaluationDetail,
    EvaluationState,
    Leaderboard,
    LeaderboardList,
    LeaderboardSummary,
    RegisteredAgent,
    ResultsRequest,
    SuiteList,
    SuiteSummary,
    TownDetail,
    TownList,
    TownSummary,
    Track,
    TrialDetail,
    TrialList,
)

M = TypeVar("M", bound=BaseModel)
Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all episodes."""
_SLOTS: Final = re.compile(rb"^wrongturn_simulator_slots ([0-9.e+]+)$", re.MULTILINE)
"""Number of simulators among the service's Prometheus metrics."""


class Client(EpisodeCalls):
    """Client of one service. Its methods may be called from several threads.

    Every method raises :class:`~wrongturn_client.ServiceUnreachableError` if nobody answers, and an
    :class:`~wrongturn_client.ApiError` if the service refuses.

    Example:
        >>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
        ...     agent = client.register("my agent", Track.PRIVILEGED)
        >>> with Client("http://127.0.0.1:8000", agent.token) as client:  # doctest: +SKIP
        ...     evaluation = client.evaluate(my_policy, "wrong-command@1")
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        transport: httpx.BaseTransport | None = None,
        timeout: float = 30.0,
        patience: float = 60.0,
        binary: bool = True,
    ) -> None:
        """Create a client; the first call connects.

        Args:
            url: The service's URL; by default ``WRONGTURN_URL``, or else the default address of ``wrongturn serve``.
            token: An agent's or the operator's token; ``WRONGTURN_TOKEN`` by default. Public calls need none.
            transport: An httpx transport, for tests.
            timeout: Seconds for each attempt at a call.
            patience: Seconds for which a call is repeated while the service is busy or does not answer; 0 for never.
                A URL at which nobody has answered yet is given up after 5 s.
            binary: Send and receive episodes as msgpack; False for JSON.
        """
        self._token = token or settings.token()
        self._transport = Transport(
            url or settings.service_url() or settings.DEFAULT_URL,
            self._token,
            transport=transport,
            timeout=timeout,
            patience=patience,
        )
        self._http = HttpCalls(self._transport, MSGPACK if binary else JSON)
        self._binary = binary
        self._timeout = timeout
        self._injected = transport is not None

    @property
    def url(self) -> str:
        """The service's URL."""
        return self._transport.url

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    # Service, suites, towns

    def live(self) -> bool:
        """Whether the service's process answers."""
        self._transport.call("GET", "/health/live")
        return True

    def ready(self) -> bool:
        """Whether the service can take episodes; waits for as long as the patience lasts."""
        self._transport.call("GET", "/health/ready")
        return True

    def simulators(self) -> int | None:
        """How many episodes can be driven at a time, all agents' together; None where the service does not say."""
        found = _SLOTS.search(self._transport.call("GET", "/metrics").content)
        return None if found is None else int(float(found[1]))

    def suites(self) -> tuple[SuiteSummary, ...]:
        """All suites."""
        return _model(SuiteList, self._transport.call("GET", "/v1/suites")).suites

    def suite(self, suite: str) -> SuiteSummary:
        """One suite, by its id such as ``wrong-command@1``."""
        return _model(SuiteSummary, self._transport.call("GET", path_of("v1", "suites", suite)))

    def trials(self, suite: str) -> tuple[TrialDetail, ...]:
        """The trials of a suite's open split, for practice; each names its twin, which can be practised too."""
        return _model(TrialList, self._transport.call("GET", path_of("v1", "suites", suite, "trials"))).trials

    def towns(self) -> tuple[TownSummary, ...]:
        """All towns."""
        return _model(TownList, self._transport.call("GET", "/v1/towns")).towns

    def town(self, town: str) -> TownDetail:
        """One town with its approaches and its geometry."""
        return _model(TownDetail, self._transport.call("GET", path_of("v1", "towns", town)))

    # Agents

    def register(
        self,
        name: str,
        track: Track,
        *,
        description: str | None = None,
        homepage: str | None = None,
        kind: AgentKind = AgentKind.SUBMITTED,
    ) -> RegisteredAgent:
        """Register an agent; its token is shown this once. Kinds but ``submitted`` need the operator's token."""
        registration = AgentRegistration(name=name, track=track, description=description, homepage=homepage, kind=kind)
        return _model(RegisteredAgent, self._create("/v1/agents", registration.model_dump(mode="json")))

    def agents(self) -> tuple[AgentDetail, ...]:
        """All registered agents."""
        return _model(AgentList, self._transport.call("GET", "/v1/agents")).agents

    def agent(self, agent: str) -> AgentDetail:
        """One agent by its id."""
        return _model(AgentDetail, self._transport.call("GET", path_of("v1", "agents", agent)))

    def rotate_token(self, agent: str) -> RegisteredAgent:
        """A new token for an agent; the old one ends. This client goes on with the old one."""
        return _model(RegisteredAgent, self._create(path_of("v1", "agents", agent, "token"), None))

    def revoke_token(self, agent: str) -> None:
        """End an agent's token."""
        self._transport.call("DELETE", path_of("v1", "agents", agent, "token"))

    # Evaluations

    def create_evaluation(self, suite: str) -> EvaluationDetail:
        """Begin an evaluation of the token's agent."""
        return _model(EvaluationDetail, self._create("/v1/evaluations", {"suite": suite}))

    def evaluation(self, evaluation: str) -> EvaluationDetail:
        """State and progress, and the metrics when finished."""
        return _model(EvaluationDetail, self._transport.call("GET", path_of("v1", "evaluations", evaluation)))

    def cancel_evaluation(self, evaluation: str) -> None:
        """Cancel an evaluation for good."""
        self._transport.call("DELETE", path_of("v1", "evaluations", evaluation))

    def open_episodes(self, evaluation: str) -> tuple[EpisodeDetail, ...]:
        """The evaluation's open episodes, to find one's way back after a crash."""
        path = path_of("v1", "evaluations", evaluation, "episodes") + "?state=open"
        return _model(EpisodeList, self._transport.call("GET", path)).episodes

    def finished_episodes(self, evaluation: str) -> tuple[EpisodeDetail, ...]:
        """The evaluation's finished episodes; their trials and outcomes are shown once all of it is finished."""
        path = path_of("v1", "evaluations", evaluation, "episodes") + "?state=finished"
        return _model(EpisodeList, self._transport.call("GET", path)).episodes

    def put_results(
        self,
        evaluation: str,
        episodes: Sequence[EpisodeRecord],
        versions: dict[str, str] | None = None,
    ) -> None:
        """Post the worker's own record of its episodes.

        Raises:
            ResultsMismatchError: it differs from what the service saw.
        """
        request = ResultsRequest(episodes=tuple(episodes), versions=versions or {})
        path = path_of("v1", "evaluations", evaluation, "results")
        self._transport.call("PUT", path, body=request.model_dump(mode="json"))

    def evaluate(
        self,
        policy: Policy,
        suite: str,
        *,
        evaluation: str | None = None,
        progress: Progress | None = None,
        versions: dict[str, str] | None = None,
        parallel: int = 1,
    ) -> EvaluationDetail:
        """Drive a policy through all trials of a suite.

        Args:
            policy: see :class:`~wrongturn_client.Policy`.
            suite: its id.
            evaluation: one that was begun before: its open episodes go on from their last reply.
            progress: called with the numbers of finished and of all episodes, at the beginning and after each.
            versions: software of the agent, by name, for the record.
            parallel: episodes driven at a time, each in a thread of its own; above 1 the policy must keep no memory
                between steps, and its ``act`` be callable in several threads at a time.

        Returns:
            The finished evaluation with its metrics.

        Raises:
            PolicyError: the policy gave something that is no action.
            Exception: whatever the policy raises. The episode counts as aborted then; the evaluation can be resumed.
        """
        if parallel < 1:
            raise ValueError(f"parallel: is {parallel}; drive 1 episode at a time or more")
        detail = self.create_evaluation(suite) if evaluation is None else self.evaluation(evaluation)
        if detail.suite != suite:
            raise WrongturnError(f"evaluation: {detail.id} is on the suite {detail.suite}, not on {suite}")
        if detail.state is EvaluationState.CANCELLED:
            raise WrongturnError(f"evaluation: {detail.id} was cancelled; begin a new one")
        records: list[EpisodeRecord] = []
        finished = detail.finished

        def count(recorder: EpisodeRecorder | None) -> None:
            nonlocal finished
            finished += 1
            if recorder is not None:
                records.append(recorder.record())
            if progress is not None:
                progress(min(finished, detail.trials), detail.trials)

        if progress is not None:
            progress(min(finished, detail.trials), detail.trials)
        if detail.state is EvaluationState.RUNNING:
            resumed = [] if evaluation is None else [episode.id for episode in self.open_episodes(detail.id)]
            with self.connection(parallel) as connection:
                EvaluationDriver(connection, policy, detail.id, parallel=parallel, resumed=resumed, on_end=count).run()
        if records:
            self.put_results(detail.id, records, {**installed_versions(), **(versions or {})})
        return self.evaluation(detail.id)

    # Episodes

    def trajectory(self, episode: str) -> bytes:
        """The trajectory's canonical JSON, byte by byte, once it may be shown."""
        return self._transport.call("GET", path_of("v1", "episodes", episode, "trajectory")).content

    def drive(self) -> Drive:
        """Open a WebSocket connection for driving: many episodes at a time, many steps in a message.

        Raises:
            NotOfferedError: The service, or a proxy before it, has no such WebSocket. HTTP does the same.
        """
        url = urlsplit(self.url)
        if not self._binary:
            raise NotOfferedError("the WebSocket is binary; this client was asked for JSON")
        if self._injected or (url.scheme in getproxies() and not proxy_bypass(url.hostname or "")):
            raise NotOfferedError("no WebSocket through a proxy or another transport; HTTP does the same")
        transport = self._transport
        return Drive(
            url,
            self._token,
            timeout=self._timeout,
            patience=transport.patience,
            availability=transport.availability,
        )

    def connection(self, parallel: int) -> DriveConnection:
        """Open a connection for driving: the WebSocket if there is one, else HTTP.

        Args:
            parallel: Calls over HTTP at a time.
        """
        try:
            return self.drive()
        except NotOfferedError:
            return HttpDrive(self._http, parallel)

    # Leaderboards

    def leaderboards(self) -> tuple[LeaderboardSummary, ...]:
        """The suites that have a leaderboard."""
        return _model(LeaderboardList, self._transport.call("GET", "/v1/leaderboards")).leaderboards

    def leaderboard(self, suite: str) -> Leaderboard:
        """The ranking on a suite."""
        return _model(Leaderboard, self._transport.call("GET", path_of("v1", "leaderboards", suite)))

    def _create(self, path: str, body: Any) -> Reply:
        return self._transport.call("POST", path, body=body, headers={"Idempotency-Key": str(uuid.uuid4())})

    def _answer(self, call: EpisodeCall) -> Result:
        try:
            return self._http.send(call)
        except ApiError as error:
            return error


def _model(kind: type[M], reply: Reply) -> M:
    return validated(kind, reply.message())
