"""Messages about evaluations and what came out of them."""

from typing import Annotated

from pydantic import FailFast, Field

from wrongturn_protocol.catalogue import Sha256
from wrongturn_protocol.episodes import EpisodeDetail, Message, Outcome, is_none
from wrongturn_protocol.vocabulary import Condition, EvaluationState, JunctionType, Reaction, Task, Verdict


class EvaluationRequest(Message):
    """``POST /v1/evaluations``."""

    suite: str


class UnsafeCount(Message):
    """Unsafe episodes out of all trials, with the 95 % interval that follows the draw (``docs/ranking.md``)."""

    count: int
    trials: int
    rate: float
    ci95: tuple[float, float]


class StrictUnsafeCount(UnsafeCount):
    """Unsafe episodes in the strict column, which decides the ranks."""

    ci83: tuple[float, float] | None = None
    """The 83.4 % interval. Two agents whose intervals do not touch differ at about 5 %. None in results that were
    counted without a service."""


class TwinCount(Message):
    """Results of the twins, which have no fault: how well the agent drives at all."""

    unsafe: int
    """Unsafe twins in the paper's column."""
    completed: int
    """Twins with the verdict ``exit_commanded`` that are not unsafe in the strict column."""
    trials: int
    ci95: tuple[float, float] | None = Field(default=None, exclude_if=is_none)
    """95 % interval of the share of completed twins; None for a suite of journeys, which have no twins."""


class ExcessUnsafeRate(Message):
    """Unsafe rate of the trials minus that of their twins (paired), both in the strict column.

    Old results have it in the paper's column: those whose ``table_strict`` is None.
    """

    value: float
    ci95: tuple[float, float]
    """95 % interval: the deviations of both rates' intervals, added in quadrature."""
    p: float
    """p-value of the exact two-sided McNemar test."""


class TableCell(Message):
    """One cell of a table by junction type and fault, as the paper's."""

    unsafe: int
    trials: int


class Infractions(Message):
    """Infractions for each kilometre driven."""

    off_road: float
    """Times the car left the road with its centre, or with three or more wheels."""
    wrong_lane: float
    """Times the car's centre entered an oncoming lane."""
    collisions: float
    """Collisions; a journey ends with the first."""


class NavigationCount(Message):
    """Journeys that reached their goal, out of all."""

    episodes: int
    success: int
    """Journeys with the verdict ``arrived``: the goal was reached in time."""
    clean: int
    """Successful journeys without any infraction."""
    rate: float
    """Share of successful journeys."""
    ci95: tuple[float, float]
    """95 % interval of ``rate``."""
    completion: float
    """Mean share of the shortest way that was covered, 0 to 1."""
    distance: float
    """Kilometres driven in all."""
    per_km: Infractions | None
    """Infractions for each kilometre; None if nothing was driven."""


class NavigationMetrics(Message):
    """Results on a suite of journeys by task and condition, counted as in CoRL 2017 (Dosovitskiy et al.)."""

    total: NavigationCount
    """Count over all trials of the suite."""
    ci83: tuple[float, float] | None = None
    """83.4 % interval of the rate of journeys that did not arrive, which decides ranks."""
    table: dict[Task, dict[Condition, NavigationCount]]
    """Counts by the tasks and conditions of the suite."""


class Severity(Message):
    """How fast the car was when an unsafe trial got its verdict, in the strict column."""

    speed_mps: float
    """Median speed at the verdict of the unsafe trials, metres per second."""
    v2_mean: float
    """Mean over all trials of the square of that speed, m²/s². A safe trial and an aborted one add 0."""


class FalseAlarms(Message):
    """Twins that the agent treated as if their command were wrong."""

    stopped: int
    """Twins that ended in a stop before or in the junction."""
    overridden: int
    """Twins that took another exit than the commanded one."""
    trials: int
    seconds_lost: float | None = None
    """Mean over all twins of the time lost, seconds. Only a twin that stood, or missed the commanded exit, loses time:
    what it took beyond the median of all others. None if there are no others, or times are not known."""


class ComplianceCount(Message):
    """Trials in which the car took the exit that was commanded, of those whose wrong command the road does not show."""

    count: int
    trials: int
    rate: float
    ci95: tuple[float, float]


class Compliance(ComplianceCount):
    """The count over all faults, and by fault."""

    faults: dict[str, ComplianceCount]


class LevelCount(UnsafeCount):
    """Unsafe trials of one level of a factor, in the strict column, with Wilson's interval."""

    completed: int
    """Twins of these trials that were completed; each trial has one twin."""


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
    severity: Severity | None = Field(default=None, exclude_if=is_none)
    """None if no trial is unsafe, speeds are not known, or it is a suite of journeys."""
    false_alarms: FalseAlarms | None = Field(default=None, exclude_if=is_none)
    """None for a suite of journeys."""
    compliance: Compliance | None = Field(default=None, exclude_if=is_none)
    """None if every trial's command can be seen to be wrong, and for a suite of journeys."""
    reactions: dict[str, dict[Reaction, int]]
    """Numbers of reactions by fault."""
    verdicts: dict[str, dict[Verdict, int]]
    """Numbers of verdicts by fault; ``none`` holds twins and journeys."""
    navigation: NavigationMetrics | None = Field(default=None, exclude_if=is_none)
    """Results of journeys; only for a suite of journeys."""
    breakdown: dict[str, dict[str, LevelCount]] | None = Field(default=None, exclude_if=is_none)
    """The strict column by factor and level, such as ``weather`` and ``new``. None for a suite whose trials differ in
    junction type and fault alone, for journeys, and in a leaderboard's entry."""
    marks: dict[str, dict[str, tuple[int, int]]] | None = Field(default=None, exclude_if=is_none)
    """Strict unsafe trials, or journeys that did not arrive, and all trials, by stratum and place: what intervals and
    the exact test read. None in a leaderboard's entry."""


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
