"""Messages about leaderboards, and the comparison of two agents."""

from typing import Annotated

from pydantic import Field

from wrongturn_protocol.accounts import AgentDetail, AgentName
from wrongturn_protocol.catalogue import Sha256
from wrongturn_protocol.episodes import Message, is_none
from wrongturn_protocol.results import Metrics, TableCell
from wrongturn_protocol.vocabulary import (
    Condition,
    Entry,
    FaultKind,
    Flag,
    JunctionType,
    Reaction,
    Task,
    Track,
    Verdict,
)


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
    speed_at_verdict: float | None = Field(default=None, exclude_if=is_none)
    """Speed at the verdict, metres per second, if it is known."""


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


class Tie(Message):
    """Another agent of the same rank and track."""

    name: AgentName
    p: float | None
    """Two-sided p-value of the exact test against it, as ``compare`` gives it. None beyond the first 50 agents of a
    rank, which are not tested."""


class LeaderboardEntry(Metrics):
    """Results of one agent on a suite, or of one algorithm over its training seeds."""

    rank: int | None
    """1 plus the number of other owners with an agent of the same track whose 83.4 % interval lies wholly below this
    one's; None if the agent is not eligible."""
    tied_with: tuple[str, ...]
    """Names of the agents with the same rank and track, in the order of the leaderboard."""
    ties: tuple[Tie, ...] = ()
    """The same agents, each with the p-value of the exact test: a tie of intervals may be none of the test."""
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


class LeaderboardList(Message):
    """``GET /v1/leaderboards``."""

    leaderboards: tuple[LeaderboardSummary, ...]
