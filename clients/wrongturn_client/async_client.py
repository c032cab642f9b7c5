"""The calls of a Wrongturn service for asyncio: those of :class:`~wrongturn_client.Client`, each to be awaited."""

from collections.abc import Sequence
from typing import Final

import httpx

from wrongturn_client.client import Client
from wrongturn_client.drive import Drive
from wrongturn_client.errors import ApiError
from wrongturn_client.evaluate import Progress
from wrongturn_client.policy import Policy
from wrongturn_client.threaded import Threaded
from wrongturn_protocol import (
    Action,
    AgentDetail,
    AgentKind,
    EpisodeDetail,
    EpisodeRecord,
    EpisodeReply,
    EvaluationDetail,
    Leaderboard,
    LeaderboardSummary,
    PracticeRequest,
    RegisteredAgent,
    StepReply,
    SuiteSummary,
    TownDetail,
    TownSummary,
    Track,
    TrialDetail,
)

_THREADS: Final = 32
"""Calls that wait for the service at a time; more wait for these."""


class AsyncDrive(Threaded):
    """A connection for driving, as :class:`~wrongturn_client.drive.Drive`; its calls go one after the other.

    Many episodes are driven by :meth:`steps`, all in one message.
    """

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        # A thread of its own: one connection is one thread's at a time, and none waits for other calls.
        super().__init__(drive, 1, "wrongturn-drive")

    async def next_episode(self, evaluation: str) -> EpisodeReply:
        """Reset: the next trial's episode."""
        return await self._run(self._drive.next_episode, evaluation)

    async def practise(self, request: PracticeRequest, *, key: str | None = None) -> EpisodeReply:
        """Reset: an episode for practice."""
        return await self._run(self._drive.practise, request, key=key)

    async def step(self, episode: str, seq: int, action: Action) -> StepReply:
        """Drive on for 0.1 s."""
        return await self._run(self._drive.step, episode, seq, action)

    async def steps(self, steps: Sequence[tuple[str, int, Action]]) -> list[StepReply | ApiError]:
        """A step of each of several episodes, in one message: the reply to each, or why it was refused."""
        return await self._run(self._drive.steps, steps)

    async def episode(self, episode: str) -> EpisodeDetail:
        """An episode, its last reply while it is open."""
        return await self._run(self._drive.episode, episode)

    async def abort_episode(self, episode: str) -> None:
        """End an episode."""
        await self._run(self._drive.abort_episode, episode)


class AsyncClient(Threaded):
    """A connection to a service, for asyncio; arguments, results and errors are those of ``Client``.

    Each call waits in a thread, so that neither the service nor a policy holds the loop up.

    Example:
        >>> async with AsyncClient("http://127.0.0.1:8000") as client:  # doctest: +SKIP
        ...     print(await client.suites())
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
        """Open nothing yet; see :class:`~wrongturn_client.Client`."""
        self._client = Client(url, token, transport=transport, timeout=timeout, patience=patience, binary=binary)
        super().__init__(self._client, _THREADS, "wrongturn-client")

    @property
    def url(self) -> str:
        """The service's URL."""
        return self._client.url

    # Service, suites, towns

    async def live(self) -> bool:
        """Whether the service's process answers."""
        return await self._run(self._client.live)

    async def ready(self) -> bool:
        """Whether the service can take episodes; waits for as long as the patience lasts."""
        return await self._run(self._client.ready)

    async def simulators(self) -> int | None:
        """How many episodes can be driven at a time, all agents' together; None where the service does not say."""
        return await self._run(self._client.simulators)

    async def suites(self) -> tuple[SuiteSummary, ...]:
        """All suites."""
        return await self._run(self._client.suites)

    async def suite(self, suite: str) -> SuiteSummary:
        """One suite."""
        return await self._run(self._client.suite, suite)

    async def trials(self, suite: str) -> tuple[TrialDetail, ...]:
        """The trials of a suite's open split."""
        return await self._run(self._client.trials, suite)

    async def towns(self) -> tuple[TownSummary, ...]:
        """All towns."""
        return await self._run(self._client.towns)

    async def town(self, town: str) -> TownDetail:
        """One town."""
        return await self._run(self._client.town, town)

    # Agents

    async def register(
        self,
        name: str,
        track: Track,
        *,
        description: str | None = None,
        homepage: str | None = None,
        kind: AgentKind = AgentKind.SUBMITTED,
    ) -> RegisteredAgent:
        """Register an agent; its token is shown this once."""
        return await self._run(
            self._client.register, name, track, description=description, homepage=homepage, kind=kind
        )

    async def agents(self) -> tuple[AgentDetail, ...]:
        """All registered agents."""
        return await self._run(self._client.agents)

    async def agent(self, agent: str) -> AgentDetail:
        """One agent."""
        return await self._run(self._client.agent, agent)

    async def rotate_token(self, agent: str) -> RegisteredAgent:
        """A new token for an agent; the old one ends."""
        return await self._run(self._client.rotate_token, agent)

    async def revoke_token(self, agent: str) -> None:
        """End an agent's token."""
        await self._run(self._client.revoke_token, agent)

    # Evaluations

    async def create_evaluation(self, suite: str) -> EvaluationDetail:
        """Begin an evaluation."""
        return await self._run(self._client.create_evaluation, suite)

    async def evaluation(self, evaluation: str) -> EvaluationDetail:
        """State and progress, and the metrics when finished."""
        return await self._run(self._client.evaluation, evaluation)

    async def cancel_evaluation(self, evaluation: str) -> None:
        """Cancel an evaluation for good."""
        await self._run(self._client.cancel_evaluation, evaluation)

    async def next_episode(self, evaluation: str) -> EpisodeReply:
        """Reset: the next trial's episode."""
        return await self._run(self._client.next_episode, evaluation)

    async def open_episodes(self, evaluation: str) -> tuple[EpisodeDetail, ...]:
        """The evaluation's open episodes."""
        return await self._run(self._client.open_episodes, evaluation)

    async def finished_episodes(self, evaluation: str) -> tuple[EpisodeDetail, ...]:
        """The evaluation's finished episodes."""
        return await self._run(self._client.finished_episodes, evaluation)

    async def put_results(
        self,
        evaluation: str,
        episodes: Sequence[EpisodeRecord],
        versions: dict[str, str] | None = None,
    ) -> None:
        """Post the worker's own record of its episodes."""
        await self._run(self._client.put_results, evaluation, episodes, versions)

    async def evaluate(
        self,
        policy: Policy,
        suite: str,
        *,
        evaluation: str | None = None,
        progress: Progress | None = None,
        versions: dict[str, str] | None = None,
        parallel: int = 1,
    ) -> EvaluationDetail:
        """Drive a policy through all trials of a suite; it and ``progress`` are called in another thread."""
        return await self._run(
            self._client.evaluate,
            policy,
            suite,
            evaluation=evaluation,
            progress=progress,
            versions=versions,
            parallel=parallel,
        )

    # Episodes

    async def practise(self, request: PracticeRequest, *, key: str | None = None) -> EpisodeReply:
        """Reset: an episode for practice."""
        return await self._run(self._client.practise, request, key=key)

    async def step(self, episode: str, seq: int, action: Action) -> StepReply:
        """Drive on for 0.1 s."""
        return await self._run(self._client.step, episode, seq, action)

    async def episode(self, episode: str) -> EpisodeDetail:
        """An episode."""
        return await self._run(self._client.episode, episode)

    async def trajectory(self, episode: str) -> bytes:
        """The trajectory's canonical JSON."""
        return await self._run(self._client.trajectory, episode)

    async def abort_episode(self, episode: str) -> None:
        """End an episode."""
        await self._run(self._client.abort_episode, episode)

    async def drive(self) -> AsyncDrive:
        """A connection over which episodes are driven with less ado."""
        return AsyncDrive(await self._run(self._client.drive))

    # Leaderboards

    async def leaderboards(self) -> tuple[LeaderboardSummary, ...]:
        """The suites that have a leaderboard."""
        return await self._run(self._client.leaderboards)

    async def leaderboard(self, suite: str) -> Leaderboard:
        """The ranking on a suite."""
        return await self._run(self._client.leaderboard, suite)
