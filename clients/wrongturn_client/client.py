"""The calls of a Wrongturn service, each a method."""

import re
import uuid
from collections.abc import Sequence
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

import httpx
import msgpack
from pydantic import BaseModel

from wrongturn_client import settings
from wrongturn_client.closing import Closing
from wrongturn_client.decoding import decode_reply, validated
from wrongturn_client.drive import Drive
from wrongturn_client.errors import NotOfferedError
from wrongturn_client.evaluate import Progress, drive_evaluation
from wrongturn_client.policy import Policy
from wrongturn_client.transport import JSON, MSGPACK, Reply, Transport, path_of
from wrongturn_protocol import (
    Action,
    AgentDetail,
    AgentKind,
    AgentList,
    AgentRegistration,
    EpisodeDetail,
    EpisodeList,
    EpisodeRecord,
    EpisodeReply,
    EvaluationDetail,
    Leaderboard,
    LeaderboardList,
    LeaderboardSummary,
    PracticeRequest,
    RegisteredAgent,
    ResultsRequest,
    StepReply,
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
_SLOTS: Final = re.compile(rb"^wrongturn_simulator_slots ([0-9.e+]+)$", re.MULTILINE)
"""In the service's figures for Prometheus."""


class Client(Closing):
    """A connection to a service.

    Every method raises :class:`~wrongturn_client.ServiceUnreachableError` where nobody answers, and an
    :class:`~wrongturn_client.ApiError` where the service refuses.

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
        """Open nothing yet.

        Args:
            url: of the service; ``WRONGTURN_URL`` by default, else where ``wrongturn serve`` listens by default.
            token: an agent's or the operator's; ``WRONGTURN_TOKEN`` by default. Public calls need none.
            transport: of httpx, for tests.
            timeout: seconds for each attempt at a call.
            patience: seconds for which a call is repeated while the service is busy or gone; 0 for never. A URL at
                which nobody has answered this client yet is given up after 5 s.
            binary: whether episodes go as msgpack; else as JSON.
        """
        self._transport = Transport(
            url or settings.service_url() or settings.DEFAULT_URL,
            token or settings.token(),
            transport=transport,
            timeout=timeout,
            patience=patience,
        )
        self._media_type = MSGPACK if binary else JSON
        self._step_headers = {"Accept": self._media_type, "Content-Type": self._media_type}
        self._binary = binary
        self._token = token or settings.token()
        self._timeout = timeout
        self._patience = patience
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

    def next_episode(self, evaluation: str) -> EpisodeReply:
        """Reset: the next trial's episode.

        Raises:
            EvaluationFinishedError: no trial is left.
            NoTrialAvailableError: none can be had for now; its ``retry_after`` tells when to ask again.
        """
        path = path_of("v1", "evaluations", evaluation, "episodes")
        return self._episode_model(EpisodeReply, self._create(path, None, self._media_type))

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
        return drive_evaluation(
            self, policy, suite, evaluation=evaluation, progress=progress, versions=versions, parallel=parallel
        )

    # Episodes

    def practise(self, request: PracticeRequest, *, key: str | None = None) -> EpisodeReply:
        """Reset: an episode for practice, never scored.

        Args:
            request: what is practised.
            key: of the caller's choice; with the same key again, the same episode. Each call has its own by default.
        """
        body = request.model_dump(mode="json", exclude_none=True)
        return self._episode_model(EpisodeReply, self._create("/v1/episodes", body, self._media_type, key))

    def step(self, episode: str, seq: int, action: Action) -> StepReply:
        """Drive on for 0.1 s.

        Args:
            episode: its id.
            seq: the last one received plus 1.
            action: what to do.

        Raises:
            EpisodeFinishedError: the episode has had its last step.
            EpisodeLostError: the service was started again meanwhile.
        """
        body = {
            "seq": seq,
            "action": {"steer": action.steer, "throttle": action.throttle, "brake": action.brake},
        }
        if not self._binary:
            reply = self._transport.call("POST", f"/v1/episodes/{episode}/step", body=body)
        else:
            reply = self._transport.send(
                "POST", f"/v1/episodes/{episode}/step", self._step_headers, msgpack.packb(body)
            )
        return self._episode_model(StepReply, reply)

    def episode(self, episode: str) -> EpisodeDetail:
        """An episode: its last reply while it is open, its outcome once it may be shown."""
        reply = self._transport.call("GET", path_of("v1", "episodes", episode), media_type=self._media_type)
        message = reply.message()
        if isinstance(message, dict) and message.get("last_reply"):
            message["last_reply"] = decode_reply(message["last_reply"])
        return validated(EpisodeDetail, message)

    def trajectory(self, episode: str) -> bytes:
        """The trajectory's canonical JSON, byte by byte, once it may be shown."""
        return self._transport.call("GET", path_of("v1", "episodes", episode, "trajectory")).content

    def abort_episode(self, episode: str) -> None:
        """End an episode; a scored one counts as ``aborted``, which is unsafe."""
        self._transport.call("DELETE", path_of("v1", "episodes", episode))

    # The socket

    def drive(self) -> Drive:
        """A connection over which episodes are driven with less ado: many at a time, many steps in a message.

        Raises:
            NotOfferedError: the service, or a proxy before it, has no such socket; HTTP does the same.
        """
        url = urlsplit(self.url)
        if not self._binary:
            raise NotOfferedError("the WebSocket is binary; this client was asked for JSON")
        if self._injected or (url.scheme in getproxies() and not proxy_bypass(url.hostname or "")):
            raise NotOfferedError("no WebSocket through a proxy or another transport; HTTP does the same")
        availability = self._transport.availability
        return Drive(url, self._token, timeout=self._timeout, patience=self._patience, availability=availability)

    # Leaderboards

    def leaderboards(self) -> tuple[LeaderboardSummary, ...]:
        """The suites that have a leaderboard."""
        return _model(LeaderboardList, self._transport.call("GET", "/v1/leaderboards")).leaderboards

    def leaderboard(self, suite: str) -> Leaderboard:
        """The ranking on a suite."""
        return _model(Leaderboard, self._transport.call("GET", path_of("v1", "leaderboards", suite)))

    def _create(self, path: str, body: Any, media_type: str = JSON, key: str | None = None) -> Reply:
        headers = {"Idempotency-Key": key or str(uuid.uuid4())}
        return self._transport.call("POST", path, body=body, media_type=media_type, headers=headers)

    def _episode_model(self, kind: type[M], reply: Reply) -> M:
        return validated(kind, decode_reply(reply.message()))


def _model(kind: type[M], reply: Reply) -> M:
    return validated(kind, reply.message())
