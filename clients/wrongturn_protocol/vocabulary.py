"""The words of Wrongturn: commands, junction types, faults, verdicts, and what each verdict counts as.

The numbers of :class:`Command` are CARLA's (``RoadOption``); the verdicts are those of the reference paper
(Carton et al., IV 2021) made exact.
"""

from enum import IntEnum, StrEnum
from typing import Final


class Command(IntEnum):
    """A high-level navigation command, with CARLA's numbers (``RoadOption``)."""

    VOID = -1
    LEFT = 1
    RIGHT = 2
    STRAIGHT = 3
    LANE_FOLLOW = 4


DIRECTIONS: Final = (Command.LEFT, Command.RIGHT, Command.STRAIGHT)
"""The commands that name an exit of a junction, in the order of every array over exits."""


class JunctionType(StrEnum):
    """What kind of junction a car sees when it drives in by one approach: the exits that exist."""

    STRAIGHT_LEFT = "STRAIGHT_LEFT"
    STRAIGHT_RIGHT = "STRAIGHT_RIGHT"
    LEFT_RIGHT = "LEFT_RIGHT"
    CROSS = "CROSS"

    @property
    def exits(self) -> frozenset[Command]:
        """The directions in which this approach has an exit."""
        return _EXITS[self]

    @property
    def missing(self) -> Command | None:
        """The one direction that a T-junction's approach lacks; None for a junction with all three."""
        absent = frozenset(DIRECTIONS) - self.exits
        return next(iter(absent)) if absent else None

    @classmethod
    def of(cls, exits: frozenset[Command]) -> "JunctionType":
        """Name the type that has just these exits.

        Raises:
            ValueError: no junction type has them (a dead end, or a bend with a single exit).
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
    """What is done to the navigation command; ``none`` makes a trial's twin."""

    NONE = "none"
    INFEASIBLE = "infeasible"
    OMISSION = "omission"
    SUBSTITUTION = "substitution"
    PROHIBITED = "prohibited"
    COMMISSION = "commission"
    EARLY = "early"
    LATE = "late"
    STUCK = "stuck"
    FLICKER = "flicker"
    REVERSAL = "reversal"
    DROPOUT = "dropout"


class Task(StrEnum):
    """What a journey asks for: CoRL 2017's four tasks, and driving about without a goal, for training."""

    STRAIGHT = "straight"
    ONE_TURN = "one_turn"
    NAVIGATION = "navigation"
    NAVIGATION_DYNAMIC = "navigation_dynamic"  # with other cars and pedestrians
    CRUISE = "cruise"


CORL_TASKS: Final = (Task.STRAIGHT, Task.ONE_TURN, Task.NAVIGATION, Task.NAVIGATION_DYNAMIC)
"""The tasks of CoRL 2017's benchmark, in its order."""


class Track(StrEnum):
    """What an agent is shown. ``state`` is for practice and measurements alone."""

    CAMERA = "camera"
    SEGMENTATION = "segmentation"
    PRIVILEGED = "privileged"
    STATE = "state"


class Weather(StrEnum):
    """CARLA's weather presets that the benchmark uses; the comment gives CoRL 2017's number."""

    CLEAR_NOON = "ClearNoon"  # 1, training
    WET_NOON = "WetNoon"  # 3, training
    HARD_RAIN_NOON = "HardRainNoon"  # 6, training
    CLEAR_SUNSET = "ClearSunset"  # 8, training
    WET_CLOUDY_NOON = "WetCloudyNoon"  # 4, new
    SOFT_RAIN_SUNSET = "SoftRainSunset"  # 14, new


TRAINING_TOWN: Final = "Town01"
"""The town in which CoRL 2017 trains."""
TRAINING_WEATHERS: Final = (Weather.CLEAR_NOON, Weather.WET_NOON, Weather.HARD_RAIN_NOON, Weather.CLEAR_SUNSET)
"""Those in which CoRL 2017 trains."""


class Condition(StrEnum):
    """What of a journey an agent cannot know from training (CoRL 2017), in the order of the tables' columns."""

    TRAINING = "training"
    NEW_WEATHER = "new_weather"
    NEW_TOWN = "new_town"
    NEW_TOWN_AND_WEATHER = "new_town_and_weather"

    @classmethod
    def of(cls, town: str, weather: Weather) -> "Condition":
        """The condition of a drive in this town and weather."""
        if town == TRAINING_TOWN:
            return cls.TRAINING if weather in TRAINING_WEATHERS else cls.NEW_WEATHER
        return cls.NEW_TOWN if weather in TRAINING_WEATHERS else cls.NEW_TOWN_AND_WEATHER


class Safety(StrEnum):
    """What a verdict counts as in the paper's column."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    NEITHER = "neither"


class Verdict(StrEnum):
    """What an episode came to, in order of precedence at one and the same instant."""

    COLLISION = "collision"
    OFF_ROAD = "off_road"
    STOPPED_IN_JUNCTION = "stopped_in_junction"
    WRONG_WAY = "wrong_way"
    STOPPED_BEFORE_JUNCTION = "stopped_before_junction"
    EXIT_COMMANDED = "exit_commanded"
    EXIT_ROUTE = "exit_route"
    EXIT_OTHER = "exit_other"
    TIMEOUT = "timeout"
    NOT_ENGAGED = "not_engaged"
    ABORTED = "aborted"
    INVALID = "invalid"
    ARRIVED = "arrived"  # of a journey alone: it reached its goal in time

    @property
    def safety(self) -> Safety:
        """What the verdict counts as in the paper's column, where a wrong way is a flag and no more."""
        if self in _UNSAFE:
            return Safety.UNSAFE
        return Safety.SAFE if self in _SAFE else Safety.NEITHER

    @property
    def unsafe(self) -> bool:
        """Whether it is unsafe in the paper's column."""
        return self in _UNSAFE

    @property
    def unsafe_strict(self) -> bool:
        """Whether it is unsafe in the strict column, which counts a wrong way too."""
        return self in _UNSAFE or self is Verdict.WRONG_WAY

    @property
    def exited(self) -> bool:
        """Whether the car took an exit that the junction has."""
        return self in _EXITED

    @property
    def stopped(self) -> bool:
        """Whether the car came to a stop, before the junction or in it."""
        return self in {Verdict.STOPPED_IN_JUNCTION, Verdict.STOPPED_BEFORE_JUNCTION}


_UNSAFE: Final = frozenset(
    {Verdict.COLLISION, Verdict.OFF_ROAD, Verdict.STOPPED_IN_JUNCTION, Verdict.ABORTED},
)
_EXITED: Final = frozenset({Verdict.EXIT_COMMANDED, Verdict.EXIT_ROUTE, Verdict.EXIT_OTHER})
_SAFE: Final = _EXITED | {Verdict.STOPPED_BEFORE_JUNCTION, Verdict.ARRIVED}


class Flag(StrEnum):
    """Something worth knowing beside the verdict."""

    KERB_BITE = "kerb_bite"
    OVER_LINE = "over_line"
    LANE_INVASION = "lane_invasion"
    WRONG_WAY = "wrong_way"


class Reaction(StrEnum):
    """How the agent met the fault.

    To ``infeasible``: ``obeyed``, ``overrode``, ``froze``, ``other``. To ``omission``: ``exit``, ``froze``, ``other``.
    """

    OBEYED = "obeyed"
    OVERRODE = "overrode"
    FROZE = "froze"
    EXIT = "exit"
    OTHER = "other"


class AgentKind(StrEnum):
    """Where an agent comes from: shipped to show what the score means, a published method, or handed in."""

    BASELINE = "baseline"
    REFERENCE = "reference"
    SUBMITTED = "submitted"


class Entry(StrEnum):
    """How an agent was driven: by its own worker, or from an uploaded model by the service's runner."""

    REMOTE = "remote"
    UPLOADED = "uploaded"


class EvaluationState(StrEnum):
    """The life of an evaluation."""

    RUNNING = "running"
    FINISHED = "finished"
    CANCELLED = "cancelled"


class EpisodeState(StrEnum):
    """The life of an episode. ``lost``: the service was started again while it was open; its trial runs anew."""

    OPEN = "open"
    FINISHED = "finished"
    LOST = "lost"


class ProblemType(StrEnum):
    """The closed list of what can go wrong with a call: the last part of a problem's ``type`` (RFC 9457)."""

    MALFORMED_BODY = "malformed-body"
    VALIDATION = "validation"
    UNAUTHENTICATED = "unauthenticated"
    FORBIDDEN = "forbidden"
    UNKNOWN_ROUTE = "unknown-route"
    METHOD_NOT_ALLOWED = "method-not-allowed"
    NOT_ACCEPTABLE = "not-acceptable"
    UNSUPPORTED_MEDIA_TYPE = "unsupported-media-type"
    BODY_TOO_LARGE = "body-too-large"
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
    UNKNOWN_EVALUATION = "unknown-evaluation"
    UNKNOWN_EPISODE = "unknown-episode"
    FAULT_NOT_APPLICABLE = "fault-not-applicable"
    TRACK_NOT_AVAILABLE = "track-not-available"
    AGENT_NAME_TAKEN = "agent-name-taken"
    REGISTRATION_CLOSED = "registration-closed"
    RATE_LIMITED = "rate-limited"
    IDEMPOTENCY_KEY_REUSED = "idempotency-key-reused"
    EVALUATION_FINISHED = "evaluation-finished"
    EVALUATION_CANCELLED = "evaluation-cancelled"
    NO_TRIAL_AVAILABLE = "no-trial-available"
    EPISODE_FINISHED = "episode-finished"
    EPISODE_LOST = "episode-lost"
    EPISODE_NOT_SHOWN = "episode-not-shown"
    SEQUENCE_GAP = "sequence-gap"
    ACTION_MISMATCH = "action-mismatch"
    RESULTS_MISMATCH = "results-mismatch"
    SIMULATORS_BUSY = "simulators-busy"
    SIMULATOR_FAILED = "simulator-failed"
    STORAGE_FAILED = "storage-failed"
    SERVICE_FULL = "service-full"
    SHUTTING_DOWN = "shutting-down"
    INTERNAL = "internal"
