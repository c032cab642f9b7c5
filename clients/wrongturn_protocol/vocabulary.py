"""The vocabulary of Wrongturn: commands, junction types, faults, verdicts, and what each verdict counts as.

The verdicts are those of the reference paper (Carton et al., IV 2021), defined exactly.
"""

from enum import StrEnum
from typing import Final

from wrongturn_faults.commands import DIRECTIONS as DIRECTIONS  # noqa: PLC0414 - other modules take it from here
from wrongturn_faults.commands import Command as Command  # noqa: PLC0414


class JunctionType(StrEnum):
    """Type of a junction as seen from one approach: the exits that exist."""

    STRAIGHT_LEFT = "STRAIGHT_LEFT"
    STRAIGHT_RIGHT = "STRAIGHT_RIGHT"
    LEFT_RIGHT = "LEFT_RIGHT"
    CROSS = "CROSS"

    @property
    def exits(self) -> frozenset[Command]:
        """Directions in which this approach has an exit."""
        return _EXITS[self]

    @property
    def missing(self) -> Command | None:
        """The direction that a T-junction lacks; None for a junction with all three."""
        absent = frozenset(DIRECTIONS) - self.exits
        return next(iter(absent)) if absent else None

    @classmethod
    def of(cls, exits: frozenset[Command]) -> "JunctionType":
        """Return the type with exactly these exits.

        Raises:
            ValueError: No type has them, as for a dead end or a bend with a single exit.
        """
        for junction_type, its_exits in _EXITS.items():
            if its_exits == exits:
                return junction_type
        names = ", ".join(sorted(command.name for command in exits)) or "none"
        raise ValueError(f"no junction type has just these exits: {names}")


_EXITS: Final = {
    JunctionType.STRAIGHT_LEFT: frozenset({Command.STRAIGHT, Command.LEFT}),
    JunctionType.STRAIGHT_RIGHT: frozenset({Command.STRAIGHT, Command.RIGHT}),
    JunctionType.LEFT_RIGHT: frozenset({Command.LEFT, Command.RIGHT}),
    JunctionType.CROSS: frozenset(DIRECTIONS),
}

PAPER_TYPES: Final = (JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT, JunctionType.LEFT_RIGHT)
"""The paper's three junction types in the order of its table's columns."""


class FaultKind(StrEnum):
    """What goes wrong in a trial: with the navigation command or, from ``pitch`` on, with car and camera.

    A trial with ``none`` is a twin.
    """

    NONE = "none"
    INFEASIBLE = "infeasible"
    OMISSION = "omission"
    SUBSTITUTION = "substitution"
    PROHIBITED = "prohibited"
    COMMISSION = "commission"
    EARLY = "early"
    LATE = "late"
    STUCK = "stuck"
    SEQUENCE = "sequence"
    FLICKER = "flicker"
    REVERSAL = "reversal"
    DROPOUT = "dropout"
    CORRECTED = "corrected"
    CONTRADICTION = "contradiction"
    PITCH = "pitch"
    HEIGHT = "height"
    FOCAL_LENGTH = "focal_length"
    NOISE = "noise"
    DELAY = "delay"
    STEERING_GAIN = "steering_gain"
    MASKED_CLASSES = "masked_classes"
    CUSTOM = "custom"  # the fault of another package


class Task(StrEnum):
    """Task of a journey: one of CoRL 2017's four, or ``cruise``, which has no goal and is for training."""

    STRAIGHT = "straight"
    ONE_TURN = "one_turn"
    NAVIGATION = "navigation"
    NAVIGATION_DYNAMIC = "navigation_dynamic"  # with other cars and pedestrians
    CRUISE = "cruise"


CORL_TASKS: Final = (Task.STRAIGHT, Task.ONE_TURN, Task.NAVIGATION, Task.NAVIGATION_DYNAMIC)
"""Tasks of CoRL 2017's benchmark, in its order."""


class Track(StrEnum):
    """What an agent is shown. ``state`` is for practice and measurements only."""

    CAMERA = "camera"
    SEGMENTATION = "segmentation"
    WORDS = "words"
    """As ``camera``, with a sentence in place of the command."""
    PRIVILEGED = "privileged"
    STATE = "state"


class View(StrEnum):
    """What a picture or a film of an episode shows."""

    TOP = "top"
    """The town from above."""
    CAMERA = "camera"
    """What the car's camera sees."""
    BOTH = "both"


class Weather(StrEnum):
    """CARLA's weather presets used here; the comments give the numbers in CoRL 2017."""

    CLEAR_NOON = "ClearNoon"  # 1, training
    WET_NOON = "WetNoon"  # 3, training
    HARD_RAIN_NOON = "HardRainNoon"  # 6, training
    CLEAR_SUNSET = "ClearSunset"  # 8, training
    WET_CLOUDY_NOON = "WetCloudyNoon"  # 4, new
    SOFT_RAIN_SUNSET = "SoftRainSunset"  # 14, new


TRAINING_TOWN: Final = "Town01"
"""The town in which CoRL 2017 trains."""
TRAINING_WEATHERS: Final = (Weather.CLEAR_NOON, Weather.WET_NOON, Weather.HARD_RAIN_NOON, Weather.CLEAR_SUNSET)
"""The weathers in which CoRL 2017 trains."""


class Condition(StrEnum):
    """What is new to an agent after training (CoRL 2017), in the order of the tables' columns."""

    TRAINING = "training"
    NEW_WEATHER = "new_weather"
    NEW_TOWN = "new_town"
    NEW_TOWN_AND_WEATHER = "new_town_and_weather"

    @classmethod
    def of(cls, town: str, weather: Weather) -> "Condition":
        """Return the condition of a drive in this town and weather."""
        if town == TRAINING_TOWN:
            return cls.TRAINING if weather in TRAINING_WEATHERS else cls.NEW_WEATHER
        return cls.NEW_TOWN if weather in TRAINING_WEATHERS else cls.NEW_TOWN_AND_WEATHER


class Safety(StrEnum):
    """What a verdict counts as in the paper."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    NEITHER = "neither"


class Verdict(StrEnum):
    """Result of an episode. If several apply at the same instant, the first in this list wins."""

    COLLISION = "collision"
    OFF_ROAD = "off_road"
    STOPPED_IN_JUNCTION = "stopped_in_junction"
    WRONG_WAY = "wrong_way"
    UNFINISHED = "unfinished"  # time ran out in the junction, or past it without an exit
    STOPPED_BEFORE_JUNCTION = "stopped_before_junction"
    EXIT_COMMANDED = "exit_commanded"
    EXIT_ROUTE = "exit_route"
    EXIT_OTHER = "exit_other"
    TIMEOUT = "timeout"
    NOT_ENGAGED = "not_engaged"
    ABORTED = "aborted"
    INVALID = "invalid"
    ARRIVED = "arrived"  # journeys only: the goal was reached in time

    @property
    def safety(self) -> Safety:
        """What the verdict counts as in the paper, where wrong ways and unfinished drives are neither."""
        if self in _UNSAFE:
            return Safety.UNSAFE
        return Safety.SAFE if self in _SAFE else Safety.NEITHER

    @property
    def unsafe(self) -> bool:
        """Whether the verdict is unsafe in the paper."""
        return self in _UNSAFE

    @property
    def unsafe_strict(self) -> bool:
        """Whether the verdict is unsafe in the strict count, which includes wrong ways and unfinished drives."""
        return self in _UNSAFE or self in {Verdict.WRONG_WAY, Verdict.UNFINISHED}

    @property
    def exited(self) -> bool:
        """Whether the car left the junction by an exit."""
        return self in _EXITED

    @property
    def stopped(self) -> bool:
        """Whether the car stopped before the junction or in it."""
        return self in {Verdict.STOPPED_IN_JUNCTION, Verdict.STOPPED_BEFORE_JUNCTION}


_UNSAFE: Final = frozenset({Verdict.COLLISION, Verdict.OFF_ROAD, Verdict.STOPPED_IN_JUNCTION, Verdict.ABORTED})
_EXITED: Final = frozenset({Verdict.EXIT_COMMANDED, Verdict.EXIT_ROUTE, Verdict.EXIT_OTHER})
_SAFE: Final = _EXITED | {Verdict.STOPPED_BEFORE_JUNCTION, Verdict.ARRIVED}


class Flag(StrEnum):
    """Something worth knowing beyond the verdict.

    Journeys have the first three. The others are of junctions; each makes any verdict unsafe in the strict column.
    """

    KERB_BITE = "kerb_bite"
    LANE_INVASION = "lane_invasion"
    WRONG_WAY = "wrong_way"
    OPPOSED_LANE = "opposed_lane"
    """The centre was driven far on opposed lanes, or was on one at the verdict."""
    STOPPED_ACROSS = "stopped_across"
    """The drive ended in a stop across the car's lane, or with the centre outside it."""
    SPEEDING = "speeding"
    """The car was faster than streets in towns allow."""
    KERB_RIDE = "kerb_ride"
    """The car was driven far with a wheel off the road."""


STRICT_FLAGS: Final = frozenset({Flag.OPPOSED_LANE, Flag.STOPPED_ACROSS, Flag.SPEEDING, Flag.KERB_RIDE})
"""Flags that make any verdict unsafe in the strict column."""


class Reaction(StrEnum):
    """How the agent reacted to the fault. ``docs/faults.md`` says which reactions each fault has."""

    OBEYED = "obeyed"
    OVERRODE = "overrode"
    FROZE = "froze"
    EXIT = "exit"
    OTHER = "other"


class AgentKind(StrEnum):
    """Origin of an agent: shipped to show what scores mean, a published method, or submitted."""

    BASELINE = "baseline"
    REFERENCE = "reference"
    SUBMITTED = "submitted"
    EXPLOIT = "exploit"
    """Shipped to show that a trick does not pay."""
    ALGORITHM = "algorithm"
    """No agent but a row over the training seeds of one."""


class Entry(StrEnum):
    """How an agent was run: by its own worker, or by the service from an uploaded model."""

    REMOTE = "remote"
    UPLOADED = "uploaded"


class EvaluationState(StrEnum):
    """State of an evaluation."""

    RUNNING = "running"
    FINISHED = "finished"
    CANCELLED = "cancelled"


class EpisodeState(StrEnum):
    """State of an episode. ``lost``: the service was restarted while it was open; its trial is driven again."""

    OPEN = "open"
    FINISHED = "finished"
    LOST = "lost"


class SubmissionState(StrEnum):
    """State of a submission.

    ``queued``: it waits for its check. ``checked``: its model works, and it waits for its turn.
    """

    QUEUED = "queued"
    CHECKED = "checked"
    RUNNING = "running"
    FINISHED = "finished"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def over(self) -> bool:
        """Whether it stays in this state for good."""
        return self in {SubmissionState.FINISHED, SubmissionState.FAILED, SubmissionState.CANCELLED}


class Collection(StrEnum):
    """What the operator administers."""

    OWNERS = "owners"
    AGENTS = "agents"
    EVALUATIONS = "evaluations"
    SUBMISSIONS = "submissions"

    @property
    def one(self) -> str:
        """What a single one is called."""
        return self.value[:-1]


class AuditAction(StrEnum):
    """What the operator did."""

    HIDE = "hide"
    UNHIDE = "unhide"
    REVOKE = "revoke"
    """Ended tokens."""
    ROTATE = "rotate"
    """Made a new token for an owner or an agent, or a new key for certificates."""
    CANCEL = "cancel"
    """Cancelled a submission."""
    DELETE = "delete"
    FREE = "free"
    """Gave back a name or a place that an earlier deletion had kept taken."""


class ProblemType(StrEnum):
    """Everything that can go wrong with a call: the last part of a problem's ``type`` (RFC 9457)."""

    MALFORMED_BODY = "malformed-body"
    VALIDATION = "validation"
    UNAUTHENTICATED = "unauthenticated"
    FORBIDDEN = "forbidden"
    UNKNOWN_ROUTE = "unknown-route"
    METHOD_NOT_ALLOWED = "method-not-allowed"
    NOT_ACCEPTABLE = "not-acceptable"
    UNSUPPORTED_MEDIA_TYPE = "unsupported-media-type"
    BODY_TOO_LARGE = "body-too-large"
    HEAD_TOO_LARGE = "head-too-large"
    REQUEST_TIMEOUT = "request-timeout"
    PROTOCOL_VERSION = "protocol-version"
    TEXT_MESSAGE = "text-message"
    MESSAGE_TOO_LARGE = "message-too-large"
    TRUNCATED_MESSAGE = "truncated-message"
    MALFORMED_MESSAGE = "malformed-message"
    UNKNOWN_SUITE = "unknown-suite"
    UNKNOWN_TOWN = "unknown-town"
    UNKNOWN_APPROACH = "unknown-approach"
    UNKNOWN_TRIAL = "unknown-trial"
    UNKNOWN_AGENT = "unknown-agent"
    UNKNOWN_OWNER = "unknown-owner"
    UNKNOWN_EVALUATION = "unknown-evaluation"
    UNKNOWN_EPISODE = "unknown-episode"
    UNKNOWN_SUBMISSION = "unknown-submission"
    FAULT_NOT_APPLICABLE = "fault-not-applicable"
    TRACK_NOT_AVAILABLE = "track-not-available"
    AGENT_NAME_TAKEN = "agent-name-taken"
    OWNER_NAME_TAKEN = "owner-name-taken"
    REGISTRATION_CLOSED = "registration-closed"
    RATE_LIMITED = "rate-limited"
    QUOTA_REACHED = "quota-reached"
    IDEMPOTENCY_KEY_REUSED = "idempotency-key-reused"
    EVALUATION_OPEN = "evaluation-open"
    EVALUATION_FINISHED = "evaluation-finished"
    EVALUATION_CANCELLED = "evaluation-cancelled"
    SUBMISSIONS_UNAVAILABLE = "submissions-unavailable"
    NO_TRIAL_AVAILABLE = "no-trial-available"
    EPISODE_FINISHED = "episode-finished"
    EPISODE_LOST = "episode-lost"
    EPISODE_NOT_SHOWN = "episode-not-shown"
    SEQUENCE_GAP = "sequence-gap"
    ACTION_MISMATCH = "action-mismatch"
    RESULTS_MISMATCH = "results-mismatch"
    SIMULATORS_BUSY = "simulators-busy"
    TOWNS_NOT_BUILT = "towns-not-built"
    SIMULATOR_FAILED = "simulator-failed"
    STORAGE_FAILED = "storage-failed"
    SERVICE_FULL = "service-full"
    SHUTTING_DOWN = "shutting-down"
    INTERNAL = "internal"
