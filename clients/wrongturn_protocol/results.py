"""Messages about agents, suites, towns, evaluations, leaderboards and problems."""

from typing import Annotated, Any, Final, Literal

from pydantic import FailFast, Field, StringConstraints, ValidationError, ValidatorFunctionWrapHandler, WrapValidator
from pydantic_core import PydanticCustomError

from wrongturn_protocol.episodes import Cell, EpisodeDetail, Fault, Journey, Message, Outcome, Start, Traffic, is_none
from wrongturn_protocol.navigation import NavigationMetrics
from wrongturn_protocol.vocabulary import (
    AgentKind,
    Command,
    Condition,
    Entry,
    EvaluationState,
    FaultKind,
    Flag,
    JunctionType,
    Reaction,
    Task,
    Track,
    Verdict,
    Weather,
)

NAME_RULE: Final = (
    "has to be 1 to 64 letters (A to Z, a to z), digits, dots, dashes, underscores and spaces, beginning with a letter "
    "or digit"
)
"""What a name of an agent or an owner has to be, in words."""


def _name_in_words(name: object, check: ValidatorFunctionWrapHandler) -> str:
    """Return a valid name. The error for another one says the rule, not the pattern."""
    try:
        valid: str = check(name)
    except ValidationError as error:
        if error.errors()[0]["type"] != "string_pattern_mismatch":
            raise
        raise PydanticCustomError("name", NAME_RULE) from None
    return valid


AgentName = Annotated[
    str,
    StringConstraints(pattern=r"^[A-Za-z0-9](?:[A-Za-z0-9._ -]{0,62}[A-Za-z0-9._-])?$", strip_whitespace=True),
    WrapValidator(_name_in_words),
]
Text = Annotated[str, StringConstraints(pattern=r"^[^\x00]*$")]
"""Text without the character NUL, which PostgreSQL does not take."""
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]


class SuiteSummary(Message):
    """One suite as ``GET /v1/suites`` lists it."""

    id: str
    """Name and version, such as ``wrong-command@2``."""
    title: str
    version: int
    sha256: Sha256
    trials: int
    """Number of trials, without their twins."""
    twins: int
    tracks: tuple[Track, ...]
    successor: str | None = None
    """Id of the suite that replaces it. A suite with a successor takes no new evaluations."""


class SuiteDetail(SuiteSummary):
    """``GET /v1/suites/{suite}``."""

    cells: tuple[Cell, ...] = ()
    """What each evaluation draws its own trials from, in the order of the open draw's trials. Empty for a suite that
    lists its trials, which are the same for everybody."""


class TrialDetail(Message):
    """One trial of the open draw, or of a suite that lists its trials."""

    id: str
    twin: str | None
    """Id of its twin, which has no fault; you can practise it too. None for a journey, which has no fault."""
    town: str
    approach: str
    junction_type: JunctionType
    route: Command
    start: Start
    weather: Weather
    traffic: Traffic
    fault: Fault
    seed: int
    window: float | None = Field(default=None, exclude_if=is_none)
    """Where the command's window opens, metres before the stop line. None: at the nominal 15."""
    journey: Journey | None = Field(default=None, exclude_if=is_none)
    """The journey; None for a trial at a single junction."""


class TrialList(Message):
    """``GET /v1/suites/{suite}/trials``."""

    trials: tuple[TrialDetail, ...]
    draw: Literal["open", "listed"] | None = None
    """``open``: the open draw, for practice; every evaluation draws its own trials. ``listed``: the suite's own trials,
    the same in every evaluation. None from a service that does not say."""


class TownSummary(Message):
    """One town as ``GET /v1/towns`` lists it."""

    name: str
    sha256: Sha256
    junctions: int
    approaches: dict[JunctionType, int]
    """Number of approaches by type."""


class ApproachDetail(Message):
    """One arm of a junction, as a car drives in."""

    id: str
    junction: str
    type: JunctionType
    exits: tuple[Command, ...]
    faults: tuple[FaultKind, ...]
    """Faults that can be applied here."""
    stop_line: tuple[float, float]
    """End of the approach's lane, town frame, metres."""
    heading: float
    """Heading of a car at the stop line, town frame, radians."""
    lane_length: float


class TownDetail(Message):
    """``GET /v1/towns/{town}``: what is needed to draw it."""

    name: str
    sha256: Sha256
    bounds: tuple[float, float, float, float]
    """Least x, least y, greatest x, greatest y, metres."""
    approaches: tuple[ApproachDetail, ...]
    road: dict[str, Any]
    """Drivable area as a GeoJSON geometry in the town frame."""
    junctions: dict[str, dict[str, Any]]
    """Area of each junction as a GeoJSON geometry."""
    lanes: dict[str, tuple[tuple[float, float], ...]]
    """Centre lines by lane id."""


class OwnerRegistration(Message):
    """``POST /v1/owners``."""

    name: AgentName
    contact: Annotated[Text, Field(max_length=300)] | None = None
    """How the operator reaches the owner; nobody else sees it."""


class OwnerDetail(Message):
    """An owner as everybody sees it: who answers for agents."""

    id: str
    name: str


class OwnerList(Message):
    """``GET /v1/owners``."""

    owners: tuple[OwnerDetail, ...]
    next: str | None = None
    """Cursor of the next page; None at the end."""


class RegisteredOwner(OwnerDetail):
    """Reply 201 to an owner's registration or a token's rotation."""

    token: str
    """The token, with which the owner registers agents. It is shown only this once."""


class AgentRegistration(Message):
    """``POST /v1/agents``."""

    name: AgentName
    track: Track
    description: Annotated[Text, Field(max_length=2000)] | None = None
    homepage: Annotated[str, Field(max_length=300, pattern=r"^https?://[^\x00]*$")] | None = None
    kind: AgentKind = AgentKind.SUBMITTED
    """Kinds other than ``submitted`` need the operator's token."""
    trained_on_faults: bool = False
    """True for an agent that met wrong commands in its training. The leaderboard marks it."""


class AgentDetail(Message):
    """An agent as everybody sees it."""

    id: str
    name: str
    track: Track
    kind: AgentKind
    owner: str = ""
    """Name of the owner."""
    description: str | None = None
    homepage: str | None = None
    trained_on_faults: bool = False
    """Whether it met wrong commands in its training, as its owner says."""


class RegisteredAgent(AgentDetail):
    """Reply 201 to a registration or a token's rotation."""

    token: str
    """The token. It is shown only this once."""


class EvaluationRequest(Message):
    """``POST /v1/evaluations``."""

    suite: str


class UnsafeCount(Message):
    """Unsafe episodes out of all trials, with Wilson's 95% interval."""

    count: int
    trials: int
    rate: float
    ci95: tuple[float, float]


class StrictUnsafeCount(UnsafeCount):
    """Unsafe episodes in the strict column, which decides the ranks."""

    ci83: tuple[float, float] | None = None
    """Wilson's 83.4 % interval. Two agents whose intervals do not touch differ at about 5 %. None in old results."""


class TwinCount(Message):
    """Results of the twins, which have no fault: how well the agent drives at all."""

    unsafe: int
    """Unsafe twins in the paper's column."""
    completed: int
    """Twins with the verdict ``exit_commanded``."""
    trials: int


class ExcessUnsafeRate(Message):
    """Unsafe rate of the trials minus that of their twins (paired), both in the strict column.

    Old results have it in the paper's column: those whose ``table_strict`` is None.
    """

    value: float
    ci95: tuple[float, float]
    """95% interval by bootstrap over junctions."""
    p: float
    """p-value of the exact two-sided McNemar test."""


class TableCell(Message):
    """One cell of a table by junction type and fault, as the paper's."""

    unsafe: int
    trials: int


class Metrics(Message):
    """Results of an evaluation."""

    unsafe: UnsafeCount
    unsafe_strict: StrictUnsafeCount
    twins: TwinCount
    excess_unsafe_rate: ExcessUnsafeRate | None
    """None for a suite of journeys, which have no twins."""
    table: dict[JunctionType, dict[str, TableCell]]
    """Unsafe episodes in the paper's column, by junction type and fault; empty for a suite of journeys."""
    table_strict: dict[JunctionType, dict[str, TableCell]] | None = Field(default=None, exclude_if=is_none)
    """The same in the strict column. None for a suite of journeys, and in old results."""
    reactions: dict[str, dict[Reaction, int]]
    """Numbers of reactions by fault."""
    verdicts: dict[str, dict[Verdict, int]]
    """Numbers of verdicts by fault; ``none`` holds twins and journeys."""
    navigation: NavigationMetrics | None = Field(default=None, exclude_if=is_none)
    """Results of journeys; only for a suite of journeys."""


class EvaluationDetail(Message):
    """Evaluation of one agent on one suite."""

    id: str
    suite: str
    agent: str
    state: EvaluationState
    trials: int
    """Number of episodes to drive: the suite's trials and their twins."""
    finished: int
    max_parallel: int
    commitment: Sha256 | None = None
    """SHA-256 of the secret's text, told from the beginning. None for a suite that lists its trials."""
    secret: str | None = None
    """The secret from which the trials were drawn, once the evaluation is finished: see ``wrongturn trials``."""
    metrics: Metrics | None = None
    """Results, once the evaluation is finished."""


class EpisodeRecord(Message):
    """A worker's own record of an episode; the service compares it with what it saw."""

    episode: str
    steps: Annotated[int, Field(ge=0)]
    actions_sha256: Sha256
    """SHA-256 of the actions as little-endian float32 [n, 3] (steer, throttle, brake)."""
    latency_ms: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Median time of the agent's decisions, milliseconds."""


class ResultsRequest(Message):
    """``PUT /v1/evaluations/{id}/results``."""

    episodes: Annotated[tuple[EpisodeRecord, ...], FailFast(), Field(max_length=20000)]
    versions: Annotated[
        dict[Annotated[str, Field(max_length=100)], Annotated[str, Field(max_length=200)]], Field(max_length=50)
    ] = Field(default_factory=dict)
    """Versions of the worker's software, by name."""


class EpisodeList(Message):
    """``GET /v1/evaluations/{id}/episodes``."""

    episodes: tuple[EpisodeDetail, ...]
    next: str | None = None
    """Cursor of the next page; None at the end."""


class EpisodeResult(Message):
    """A finished episode of a finished evaluation."""

    id: str
    trial: str
    outcome: Outcome


class SeedSpread(Message):
    """Median and range of a count over training seeds."""

    median: float
    lowest: int
    highest: int


class Seeds(Message):
    """Results over the training seeds of an algorithm, on the open draw."""

    count: int
    """Number of training seeds."""
    unsafe: SeedSpread
    unsafe_strict: SeedSpread
    twins_completed: SeedSpread


class SeedOutcome(Message):
    """How one trial or twin ended for one training seed."""

    verdict: Verdict
    reaction: Reaction | None = None
    flags: tuple[Flag, ...] = ()


class AlgorithmResult(Message):
    """Outcomes of an algorithm's training seeds on a suite's open draw.

    Packages name a function ``(suite_id) -> Sequence[AlgorithmResult]`` by an entry point in the group
    ``wrongturn.algorithms``. The leaderboard then lists a row per algorithm.
    """

    name: AgentName
    track: Track
    suite: str
    """Id of the suite."""
    sha256: Sha256
    """Checksum of the suite. A row of another checksum is left out."""
    seeds: Annotated[dict[int, dict[str, SeedOutcome]], Field(min_length=1)]
    """For each training seed, the outcomes by id of the trial or twin of the open draw."""


class LeaderboardEntry(Metrics):
    """Results of one agent on a suite, or of one algorithm over its training seeds."""

    rank: int | None
    """1 plus the number of other owners with an agent of the same track whose 83.4 % interval lies wholly below this
    one's; None if the agent is not eligible."""
    tied_with: tuple[str, ...]
    """Names of the agents with the same rank and track."""
    eligible: bool
    why_not: str | None
    """The reason, if not eligible."""
    agent: AgentDetail
    entry: Entry | None
    """How the agent was run; None for an algorithm."""
    evaluation: str | None
    """Id of the evaluation; None for an algorithm, whose other figures are those of its median seed."""
    aborted: int = 0
    """Number of trials and twins that the agent gave up, stayed away from, or left when it closed the evaluation."""
    owner_agents: int = 1
    """Number of agents with an entry on this suite that the same owner has: who tries often becomes visible."""
    cancelled: int = 0
    """Evaluations that the agent began and cancelled, in version 1 only: version 2 counts what was begun."""
    seeds: Seeds | None = Field(default=None, exclude_if=is_none)
    """Results over training seeds; only in a row of an algorithm."""


class Leaderboard(Message):
    """``GET /v1/leaderboards/{suite}``."""

    suite: str
    sha256: Sha256
    updated: str | None
    """When the newest evaluation was finished, ISO 8601 in UTC; None if there is none."""
    successor: str | None = None
    """Id of the suite that replaces this one, whose entries then have no rank."""
    entries: tuple[LeaderboardEntry, ...]


class StratumComparison(Message):
    """Unsafe trials of two agents in one stratum: a junction type and fault, or a task and condition of journeys."""

    junction_type: JunctionType | None = Field(default=None, exclude_if=is_none)
    fault: FaultKind | None = Field(default=None, exclude_if=is_none)
    task: Task | None = Field(default=None, exclude_if=is_none)
    """Only for a suite of journeys, where ``unsafe`` counts those that did not arrive."""
    condition: Condition | None = Field(default=None, exclude_if=is_none)
    a: TableCell
    b: TableCell


class Comparison(Message):
    """``GET /v1/leaderboards/{suite}/compare``: two agents, stratum by stratum."""

    suite: str
    a: AgentDetail
    b: AgentDetail
    strata: tuple[StratumComparison, ...]
    """Strict unsafe trials by junction type and fault; journeys that did not arrive by task and condition."""
    total_a: TableCell
    total_b: TableCell
    difference: float
    """Rate of ``a`` minus that of ``b``."""
    p: float
    """Two-sided p-value of the exact test within strata."""
    sentence: str
    """What the figures say, and what else a reader has to know."""


class LeaderboardSummary(Message):
    """One leaderboard as ``GET /v1/leaderboards`` lists it."""

    suite: str
    sha256: Sha256
    title: str
    updated: str | None
    entries: int
    successor: str | None = None
    """Id of the suite that replaces it. Entries of a suite with a successor have no rank."""


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
    next: str | None = None
    """Cursor of the next page; None at the end."""


class FieldError(Message):
    """Error in one field of a request."""

    path: str
    """Path of the field, such as ``action.steer``."""
    message: str


class Problem(Message):
    """Error reply, ``application/problem+json`` (RFC 9457)."""

    type: str
    """``/problems/`` and a :class:`~wrongturn_protocol.vocabulary.ProblemType`; that page explains it."""
    title: str
    status: int
    detail: str
    errors: tuple[FieldError, ...] = ()
    position: Annotated[int, Field(ge=1)] | None = Field(default=None, exclude_if=is_none)
    """Position in the queue, with 429 and 503: 1 means that it is your turn when the next place is free.

    The queue is the one for simulators, where your place is kept if you come back after ``Retry-After``; or your own,
    if you met a limit of your own.
    """
