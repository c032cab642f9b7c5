"""Agents, suites, towns, evaluations, the leaderboard and problems, as they go over the wire."""

from typing import Annotated, Any

from pydantic import Field, StringConstraints

from wrongturn_protocol.episodes import EpisodeDetail, Fault, Journey, Message, Outcome, Start, Traffic, is_none
from wrongturn_protocol.navigation import NavigationMetrics
from wrongturn_protocol.vocabulary import (
    AgentKind,
    Command,
    Entry,
    EvaluationState,
    FaultKind,
    JunctionType,
    Reaction,
    Track,
    Verdict,
    Weather,
)

AgentName = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9](?:[A-Za-z0-9._ -]{0,62}[A-Za-z0-9._-])?$", strip_whitespace=True)
]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]


class SuiteSummary(Message):
    """One suite as ``GET /v1/suites`` lists it."""

    id: str
    """Name and version, such as ``wrong-command@1``."""
    title: str
    version: int
    sha256: Sha256
    trials: int
    """Without their twins."""
    twins: int
    tracks: tuple[Track, ...]


class TrialDetail(Message):
    """One trial of the open split."""

    id: str
    twin: str | None
    """The id of the same trial without its fault; it can be practised too. None of a journey, which has no fault."""
    town: str
    approach: str
    junction_type: JunctionType
    route: Command
    start: Start
    weather: Weather
    traffic: Traffic
    fault: Fault
    seed: int
    journey: Journey | None = Field(default=None, exclude_if=is_none)
    """Of a drive across the town."""


class TrialList(Message):
    """``GET /v1/suites/{suite}/trials``."""

    trials: tuple[TrialDetail, ...]


class TownSummary(Message):
    """One town as ``GET /v1/towns`` lists it."""

    name: str
    sha256: Sha256
    junctions: int
    approaches: dict[JunctionType, int]
    """How many approaches there are of each type."""


class ApproachDetail(Message):
    """One arm of a junction, seen by a car driving in."""

    id: str
    junction: str
    type: JunctionType
    exits: tuple[Command, ...]
    faults: tuple[FaultKind, ...]
    """Faults that can be applied here."""
    stop_line: tuple[float, float]
    """Where the approach's lane ends, town frame, metres."""
    heading: float
    """Of a car at the stop line, radians, town frame."""
    lane_length: float


class TownDetail(Message):
    """``GET /v1/towns/{town}``: enough to draw it."""

    name: str
    sha256: Sha256
    bounds: tuple[float, float, float, float]
    """x least, y least, x greatest, y greatest, metres."""
    approaches: tuple[ApproachDetail, ...]
    road: dict[str, Any]
    """The drivable area as a GeoJSON geometry in the town frame."""
    junctions: dict[str, dict[str, Any]]
    """Each junction's area as a GeoJSON geometry."""
    lanes: dict[str, tuple[tuple[float, float], ...]]
    """Centre lines by lane id."""


class AgentRegistration(Message):
    """``POST /v1/agents``."""

    name: AgentName
    track: Track
    description: Annotated[str, Field(max_length=2000)] | None = None
    homepage: Annotated[str, Field(max_length=300, pattern=r"^https?://")] | None = None
    kind: AgentKind = AgentKind.SUBMITTED
    """Others than ``submitted`` need the operator's token."""


class AgentDetail(Message):
    """An agent as anybody sees it."""

    id: str
    name: str
    track: Track
    kind: AgentKind
    description: str | None = None
    homepage: str | None = None


class RegisteredAgent(AgentDetail):
    """201 to a registration or a token's rotation."""

    token: str
    """Shown this once."""


class EvaluationRequest(Message):
    """``POST /v1/evaluations``."""

    suite: str


class UnsafeCount(Message):
    """Unsafe episodes of a fixed number of trials, with Wilson's 95 % interval."""

    count: int
    trials: int
    rate: float
    ci95: tuple[float, float]


class TwinCount(Message):
    """The same trials without fault: how well the agent drives at all."""

    unsafe: int
    completed: int
    """Ended in ``exit_commanded``."""
    trials: int


class ExcessUnsafeRate(Message):
    """Unsafe rate of the trials less that of their twins (paired)."""

    value: float
    ci95: tuple[float, float]
    """Bootstrap over junctions."""
    p: float
    """Exact McNemar, two-sided."""


class Cell(Message):
    """One cell of the paper's table."""

    unsafe: int
    trials: int


class Metrics(Message):
    """What an evaluation came to."""

    unsafe: UnsafeCount
    unsafe_strict: UnsafeCount
    twins: TwinCount
    excess_unsafe_rate: ExcessUnsafeRate | None
    """None for a suite of journeys: they have no twins."""
    table: dict[JunctionType, dict[str, Cell]]
    """By junction type and fault; empty for a suite of journeys."""
    reactions: dict[str, dict[Reaction, int]]
    """By fault."""
    verdicts: dict[str, dict[Verdict, int]]
    """By fault, ``none`` for the twins and for journeys."""
    navigation: NavigationMetrics | None = Field(default=None, exclude_if=is_none)
    """Of a suite of journeys alone."""


class EvaluationDetail(Message):
    """An evaluation: one agent on one suite."""

    id: str
    suite: str
    agent: str
    state: EvaluationState
    trials: int
    """Episodes to run: the suite's trials and their twins."""
    finished: int
    max_parallel: int
    metrics: Metrics | None = None
    """When finished."""


class EpisodeRecord(Message):
    """What a worker says of one of its episodes; the service compares it with what it saw."""

    episode: str
    steps: Annotated[int, Field(ge=0)]
    actions_sha256: Sha256
    """Of the actions as little-endian float32 [n, 3] in the order steer, throttle, brake."""
    latency_ms: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """The agent's own median time for a decision."""


class ResultsRequest(Message):
    """``PUT /v1/evaluations/{id}/results``."""

    episodes: Annotated[tuple[EpisodeRecord, ...], Field(max_length=20000)]
    versions: Annotated[dict[str, str], Field(max_length=50)] = Field(default_factory=dict)
    """Software of the worker, by name."""


class EpisodeList(Message):
    """``GET /v1/evaluations/{id}/episodes``."""

    episodes: tuple[EpisodeDetail, ...]


class EpisodeResult(Message):
    """A finished episode of a finished evaluation."""

    id: str
    trial: str
    outcome: Outcome


class LeaderboardEntry(Metrics):
    """One agent on a suite."""

    rank: int | None
    """1 plus the number of ranked agents of the same track that are significantly better; None where not eligible."""
    tied_with: tuple[str, ...]
    """Names of agents of the same rank and track."""
    eligible: bool
    why_not: str | None
    """The reason, where not eligible."""
    agent: AgentDetail
    entry: Entry
    evaluation: str
    cancelled: int = 0
    """Evaluations on the suite that it began to drive and cancelled: who cancels until one is lucky, shows it."""


class Leaderboard(Message):
    """``GET /v1/leaderboards/{suite}``."""

    suite: str
    sha256: Sha256
    updated: str | None
    """When the newest evaluation on it was finished, ISO 8601 in UTC; None where there is none yet."""
    entries: tuple[LeaderboardEntry, ...]


class LeaderboardSummary(Message):
    """One leaderboard as ``GET /v1/leaderboards`` lists it."""

    suite: str
    sha256: Sha256
    title: str
    updated: str | None
    entries: int


class LeaderboardList(Message):
    """``GET /v1/leaderboards``."""

    leaderboards: tuple[LeaderboardSummary, ...]


class SuiteList(Message):
    """``GET /v1/suites``."""

    suites: tuple[SuiteSummary, ...]


class TownList(Message):
    """``GET /v1/towns``."""

    towns: tuple[TownSummary, ...]


class AgentList(Message):
    """``GET /v1/agents``."""

    agents: tuple[AgentDetail, ...]


class FieldError(Message):
    """What is wrong with one field."""

    path: str
    """Dotted, such as ``action.steer``."""
    message: str


class Problem(Message):
    """RFC 9457's problem details, ``application/problem+json``."""

    type: str
    """``/problems/`` and one of :class:`~wrongturn_protocol.vocabulary.ProblemType`; the service explains it there."""
    title: str
    status: int
    detail: str
    errors: tuple[FieldError, ...] = ()
    position: Annotated[int, Field(ge=1)] | None = Field(default=None, exclude_if=is_none)
    """With 429 and 503: how many places have to become free until it is this call's turn, 1 the next.

    Of simulators where the call stands in the line for one, which is kept for who comes back after ``Retry-After``; of
    one's own where a limit of one's own is met.
    """
