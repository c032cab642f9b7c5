"""Trials, actions and the messages of an episode."""

from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from wrongturn_protocol.suggestions import did_you_mean
from wrongturn_protocol.vocabulary import (
    CORL_TASKS,
    STRICT_FLAGS,
    Command,
    EpisodeState,
    FaultKind,
    Flag,
    JunctionType,
    Reaction,
    Task,
    Track,
    Verdict,
    Weather,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

CONTROLS: Final = ("steer", "throttle", "brake")
"""The fields of an action, in the order of its array."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
ScenerySeed = Annotated[int, Field(ge=0, lt=2**53)]
"""JavaScript and JSON libraries keep such numbers exactly."""


WATCH: Final = 2.0
"""Seconds for which a drive is watched after an exit, if no secret draws them."""


def is_none(value: object) -> bool:
    """Return whether to leave a field out, so that suites and trajectories from before it existed keep their bytes."""
    return value is None


def is_plain_watch(value: object) -> bool:
    """Return whether to leave :attr:`Trial.watch` out, for the same reason: a trial without it has this value."""
    return value == WATCH


ObservationMessage = dict[str, Any]
"""Observation in JSON or msgpack, with the keys and shapes of the Gymnasium space; see ``docs/observations.md``."""


class Message(BaseModel):
    """Base of all messages: immutable, and unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


_RANGES: Final = {"steer": "-1 to 1", "throttle": "0 to 1", "brake": "0 to 1"}


class ActionError(ValueError):
    """The values of an :class:`Action` are not three numbers in their ranges. The text is one line."""


def action_error(error: ValidationError) -> str:
    """Return the first error in the values of an :class:`Action`, in one line. An unknown field comes first."""
    first = min(error.errors(include_url=False), key=lambda each: each["type"] != "extra_forbidden")
    field = str(first["loc"][0])
    if field not in _RANGES:
        return f"action.{field}: there is no such field; give steer, throttle and brake{did_you_mean(field, CONTROLS)}"
    given = "missing" if first["type"] == "missing" else repr(first["input"])
    return f"action.{field} is {given}; give a number from {_RANGES[field]}"


class Action(Message):
    """What the car does for the next 0.1 s: ``Action(steer, throttle, brake)``, by position or by name.

    Each value is rounded to float32 before it is used. NumPy takes an action for an array of three.
    """

    steer: Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
    """Steering, from -1 (full left) to 1 (full right), as CARLA's ``VehicleControl.steer``."""
    throttle: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
    """Throttle, 0 to 1."""
    brake: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
    """Brake, 0 to 1; it overrides the throttle."""

    if TYPE_CHECKING:

        def __init__(self, steer: float, throttle: float, brake: float) -> None: ...

    else:

        def __init__(self, /, *values: float, **named: float) -> None:
            if len(values) > len(CONTROLS):
                raise TypeError(f"Action: {len(values)} values are given; give {', '.join(CONTROLS)}")
            try:
                super().__init__(**dict(zip(CONTROLS, values, strict=False)), **named)
            except ValidationError as error:
                raise ActionError(action_error(error)) from None

        # Messages are parsed without calling this, as if it were pydantic's own.
        __init__.__pydantic_base_init__ = True

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> "NDArray[Any]":
        """Return steer, throttle and brake, (3,), float32 by default."""
        import numpy as np  # noqa: PLC0415 - slow, and the program needs it seldom

        return np.array((self.steer, self.throttle, self.brake), dtype or np.float32)


class Start(Message):
    """Position, heading and speed at which a trial begins, relative to the approach's lane."""

    distance: Finite
    """From the body's centre to the stop line along the lane, metres. Negative only in a cruise: the car starts that
    far past the stop line, on the route's path through the junction."""
    speed: Annotated[float, Field(ge=0, le=22, allow_inf_nan=False)]
    """Speed, metres per second."""
    lateral: Finite
    """Offset from the lane's centre line, metres, positive to the left."""
    yaw: Finite
    """Heading relative to the lane's, radians, positive to the left."""


class Traffic(Message):
    """Number of other road users in the town. If the town has no room for them, the reset is refused."""

    vehicles: Annotated[int, Field(ge=0, le=200)] = 0
    pedestrians: Annotated[int, Field(ge=0, le=200)] = 0


class Fault(Message):
    """What happens to the command, and how much of it. ``docs/faults.md`` has the kinds and their doses."""

    kind: FaultKind
    onset: None = None
    duration: None = None
    severity: None = None
    """Always null, as the two before. Trials from before doses have these three fields, and keep their bytes."""
    dose: Finite | None = Field(default=None, exclude_if=is_none)
    """How strong the fault is; each kind has a unit and a range of its own. None: the kind's usual dose."""
    period: Finite | None = Field(default=None, exclude_if=is_none)
    """Seconds after which a fault repeats itself; only ``flicker`` has one. None: the usual."""

    @property
    def label(self) -> str:
        """The kind and what is given of dose and period, as ids of trials name them: ``late-7p5``."""
        given = [f"{one:g}" for one in (self.dose, self.period) if one is not None]
        # Dots part the fields of an id.
        return "-".join([self.kind, *(text.replace("-", "m").replace(".", "p") for text in given)])


class Journey(Message):
    """Drive over any number of junctions: to a goal (CoRL 2017's tasks), or without one (cruise)."""

    task: Task
    goal: str | None = None
    """The goal's lane. None without a goal: the seed then decides the exit at each junction."""
    goal_at: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """The goal's position along its lane, metres."""
    length: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Length of the shortest way from the start to the goal, metres."""
    time_limit: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    """Time limit, seconds. With a goal it is the time of the shortest way at 10 km/h, as in CoRL 2017."""

    @model_validator(mode="after")
    def _goal_fits_task(self) -> Self:
        if (self.task is Task.CRUISE) != (self.goal is None):
            raise ValueError(f"goal: a {self.task} {'has none' if self.goal else 'needs one'}")
        return self


class Fork(Message):
    """Another command from one decision of a drive on."""

    decision: Annotated[int, Field(ge=0, lt=2**31)]
    """The first decision with the other command. Decisions are 0.1 s apart; 0 is the reset."""
    command: Command | None = None
    """The command from then on. None: the route's, which is the right one."""


class Trial(Message):
    """One test: where a car starts, where its route leads, and what happens to its command.

    A trial with a journey begins before its approach and continues past the junction; ``route`` is then the direction
    of the shortest way there.
    """

    id: str
    """Readable, stable name, such as ``Town01.J3-S.infeasible.s17``."""
    town: str
    approach: str
    """The arm by which the car enters, such as ``J3-S``: junction J3 from its southern arm."""
    junction_type: JunctionType
    route: Command
    """Direction of the route at the junction."""
    start: Start
    weather: Weather = Weather.CLEAR_NOON
    traffic: Traffic = Traffic()
    fault: Fault
    seed: Seed
    """Seed of every random draw in the episode."""
    window: Annotated[float, Field(gt=0, le=60, allow_inf_nan=False)] | None = Field(default=None, exclude_if=is_none)
    """Where the command's window opens, metres before the stop line. None: at the nominal 15."""
    watch: Annotated[float, Field(ge=1, le=4, allow_inf_nan=False)] = Field(default=WATCH, exclude_if=is_plain_watch)
    """For how long a drive goes on after it took an exit, seconds; JSON leaves 2.0 out. A journey does not use it."""
    scenery: ScenerySeed | None = Field(default=None, exclude_if=is_none)
    """Seed of the town's drawn scenery. None: the scenery that the town ships with."""
    next_route: Literal[Command.LEFT, Command.RIGHT, Command.STRAIGHT] | None = Field(default=None, exclude_if=is_none)
    """Direction of the route at the junction after this one. None: the seed decides."""
    journey: Journey | None = Field(default=None, exclude_if=is_none)
    """The journey; None for a trial at a single junction."""
    fork: Fork | None = Field(default=None, exclude_if=is_none)
    """Another command than the fault's, if this is a fork of an earlier drive."""

    @model_validator(mode="after")
    def _route_exists(self) -> Self:
        if self.route not in self.junction_type.exits:
            raise ValueError(f"route: {self.junction_type} has no exit {self.route.name}")
        return self

    @model_validator(mode="after")
    def _start_is_before_the_stop_line(self) -> Self:
        cruise = self.journey is not None and self.journey.task is Task.CRUISE
        if not (self.start.distance > 0 or cruise):
            raise ValueError("start.distance: must be greater than 0; only a cruise may start inside a junction")
        return self

    @property
    def is_twin(self) -> bool:
        """Whether this is the trial without fault of a pair."""
        return self.fault.kind is FaultKind.NONE and self.journey is None

    def twin(self) -> "Trial":
        """Return the same trial with the fault ``none``."""
        return self.model_copy(update={"id": twin_id(self), "fault": Fault(kind=FaultKind.NONE)})


def trial_id(town: str, approach: str, fault: Fault, seed: int) -> str:
    """Return the readable name of a trial."""
    return f"{town}.{approach}.{fault.label}.s{seed}"


def twin_id(trial: Trial) -> str:
    """Return the name of a trial's twin."""
    return trial_id(trial.town, trial.approach, Fault(kind=FaultKind.NONE), trial.seed)


class Cell(Message):
    """A trial of a suite that has not been drawn yet. The draw chooses approach, route, start, window, watch, seed.

    It has a junction type and a fault; or a task of CoRL 2017 for a journey, of which the draw chooses start and goal.
    """

    town: str
    """The town's name, or ``drawn 0``, ``drawn 1`` and so on: a town that the secret makes."""
    junction_type: JunctionType | None = Field(default=None, exclude_if=is_none)
    fault: Fault = Fault(kind=FaultKind.NONE)
    task: Task | None = Field(default=None, exclude_if=is_none)
    """The task of a journey, which has neither junction type nor fault."""
    weather: Weather = Weather.CLEAR_NOON
    traffic: Traffic = Traffic()

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if (self.task is None) == (self.junction_type is None):
            raise ValueError("junction_type: a cell has one, with a fault, or a task")
        if self.task is not None and (self.task not in CORL_TASKS or self.fault.kind is not FaultKind.NONE):
            raise ValueError("task: a journey has a goal and no fault; choose a task of CoRL 2017, and leave fault out")
        return self


class PracticeRequest(Message):
    """``POST /v1/episodes``: a practice episode, which is never scored.

    Ask in one of three ways: name a trial of an open split by ``suite`` and ``trial``; describe a trial by ``town`` and
    ``approach``; or describe a journey by ``town`` and ``task`` (and its first ``approach``, if that matters). What you
    leave out is drawn from the seed, as for the trials of suites.
    """

    suite: str | None = None
    trial: str | None = None
    town: str | None = None
    approach: str | None = None
    task: Task | None = None
    """The task of a journey."""
    route: Literal[Command.LEFT, Command.RIGHT, Command.STRAIGHT] | None = None
    fault: Fault | FaultKind = FaultKind.NONE
    weather: Weather = Weather.CLEAR_NOON
    traffic: Traffic = Traffic()
    seed: Seed = 0
    track: Track | None = None
    """The agent's own track, which is the default and the only one."""

    @model_validator(mode="after")
    def _one_way_of_asking(self) -> Self:
        if (self.suite is None) != (self.trial is None):
            raise ValueError("suite and trial go together: name both, or describe the episode by town and approach")
        if (self.suite is None) == (self.town is None):
            raise ValueError("name either suite and trial, or town and approach, or for a journey town and task")
        if self.task is not None:
            self._journey_is_plain()
        elif (self.town is None) != (self.approach is None):
            raise ValueError("town and approach go together: name both, or for a journey town and task")
        if self.suite is not None and self.traffic != Traffic():
            raise ValueError("traffic: a suite's trial has its own; describe the episode by town and approach instead")
        return self

    def _journey_is_plain(self) -> None:
        if self.town is None:
            raise ValueError("task: a suite's trial has its own; describe a journey by town and task instead")
        if self.route is not None:
            raise ValueError("route: a journey's leads to its goal; leave it out, or task")
        if self.approach is not None and self.task is Task.CRUISE:
            raise ValueError("approach: a cruise begins anywhere; leave it out, or take another task")
        kind = self.fault.kind if isinstance(self.fault, Fault) else self.fault
        if kind is not FaultKind.NONE:
            raise ValueError("fault: a journey has none; leave it out, or task")


class WhatIfRequest(Message):
    """``POST /v1/whatifs``: a fork of a finished episode, as practice."""

    episode: str
    """The finished episode: of a finished evaluation, or practice."""
    at: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    """When the other command begins, seconds after the start: the next decision from then on, 0.1 s apart."""
    command: Command | None = None
    """The other command. None: the route's, which is the right one."""


class EpisodeReply(Message):
    """Reply 201 to a reset."""

    id: str
    """Random id, which reveals nothing about the trial."""
    seq: Literal[0] = 0
    observation: ObservationMessage
    town: str | None = None
    """The town's name; only in the privileged track and in practice."""
    trial: str | None = None
    """The trial's id; only in practice."""
    lease_expires_in_s: float


class StepRequest(Message):
    """``POST /v1/episodes/{id}/step``."""

    seq: Annotated[int, Field(ge=1)]
    """The ``seq`` of the last reply, plus 1."""
    action: Action


class StepReply(Message):
    """Reply 200 to a step."""

    seq: int
    observation: ObservationMessage
    terminated: bool
    """Whether the episode is over and has its verdict."""
    truncated: bool
    """Whether the episode is over because its time ran out."""
    reward: float | None = None
    """Reward of the step; only in practice."""
    verdict: Verdict | None = None
    """The verdict; only in practice, with the last step."""


class JourneyOutcome(Message):
    """Figures of a journey, beside its verdict."""

    distance: float
    """Metres driven."""
    completion: float
    """Share of the shortest way that was covered, 0 to 1; always 1 without a goal."""
    junctions: int
    """Junctions left by a permitted exit."""
    off_road: int
    """Times the car left the road with its centre, or with three or more wheels."""
    wrong_lane: int
    """Times the car's centre entered an oncoming lane."""
    collisions: int
    """0 or 1: a journey ends with the first."""

    @property
    def clean(self) -> bool:
        """Whether the journey had no infraction."""
        return not (self.off_road or self.wrong_lane or self.collisions)


class Outcome(Message):
    """Verdict and figures of an episode."""

    verdict: Verdict
    reaction: Reaction | None = None
    """Reaction to the fault; None without a fault."""
    flags: tuple[Flag, ...] = ()
    """Flags, sorted and without repetition."""
    exit: Command | None = None
    """Direction of the exit taken."""
    time: float
    """Time of the verdict, seconds."""
    min_ttc: float | None = None
    """Least time to collision, seconds; None if the car approached nothing."""
    max_deceleration: float
    """Greatest deceleration, metres per second squared."""
    kerb_bite_m: float | None = Field(default=None, exclude_if=is_none)
    """Distance driven with one or two wheels off the road, metres. None for a journey, as for the next fields."""
    kerb_bite_s: float | None = Field(default=None, exclude_if=is_none)
    """Time with one or two wheels off the road, seconds."""
    opposed_lane_m: float | None = Field(default=None, exclude_if=is_none)
    """Distance that the centre was driven on opposed lanes, metres."""
    over_line_m: float | None = Field(default=None, exclude_if=is_none)
    """How far the nose of a car that stopped before the junction is past the stop line, metres; 0 if it is not."""
    stop_past_line_m: float | None = Field(default=None, exclude_if=is_none)
    """How far the nose of a car that stopped before or in the junction is past the stop line, metres; negative before
    it."""
    speed_at_verdict: float | None = Field(default=None, exclude_if=is_none)
    """Speed at the verdict, metres per second."""
    min_ttc_users: float | None = Field(default=None, exclude_if=is_none)
    """``min_ttc`` with other road users alone, seconds."""
    min_ttc_solids: float | None = Field(default=None, exclude_if=is_none)
    """``min_ttc`` with solid scenery alone, seconds."""
    first_stop_s: float | None = Field(default=None, exclude_if=is_none)
    """Time at which the car first began to stand, seconds; None if it never did."""
    journey: JourneyOutcome | None = Field(default=None, exclude_if=is_none)
    """Figures of the journey, if the trial has one."""

    @property
    def unsafe_strict(self) -> bool:
        """Whether the episode is unsafe in the strict column, where the flags of junctions count too."""
        return self.verdict.unsafe_strict or not STRICT_FLAGS.isdisjoint(self.flags)

    @property
    def completed(self) -> bool:
        """Whether a twin with this outcome is completed: it took the exit that was commanded, and is not unsafe."""
        return self.verdict is Verdict.EXIT_COMMANDED and not self.unsafe_strict


class EpisodeDetail(Message):
    """``GET /v1/episodes/{id}``."""

    id: str
    state: EpisodeState
    seq: int
    """``seq`` of the last reply."""
    evaluation: str | None = None
    origin: str | None = Field(default=None, exclude_if=is_none)
    """Id of the episode that this one is a fork of."""
    last_reply: dict[str, Any] | None = None
    """Reply to the last call; only while the episode is open."""
    trial: str | None = None
    """The trial's id, once it may be shown."""
    trial_detail: Trial | None = Field(default=None, exclude_if=is_none)
    """The trial, once it may be shown."""
    outcome: Outcome | None = None
    """The outcome, once it may be shown."""
    trajectory_sha256: str | None = None
    """SHA-256 of the trajectory's canonical JSON, once it may be shown."""
    actions_sha256: str | None = None
    """SHA-256 of the actions as little-endian float32 [n, 3] (steer, throttle, brake), once it may be shown."""
