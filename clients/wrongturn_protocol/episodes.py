"""Trials, actions and the messages of an episode."""

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wrongturn_protocol.vocabulary import (
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

Finite = Annotated[float, Field(allow_inf_nan=False)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


def is_none(value: object) -> bool:
    """What is not there is not written either: suites and trajectories without it keep their bytes."""
    return value is None


ObservationMessage = dict[str, Any]
"""An observation in JSON or msgpack: the keys and shapes of the Gymnasium space, see ``docs/observations.md``."""


class Message(BaseModel):
    """What goes over the wire: immutable, and nothing unknown is let in."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Action(Message):
    """What the car is told to do for the next 0.1 s; each is rounded to float32 before it is used."""

    steer: Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
    """Steering, -1 full left to 1 full right (CARLA's ``VehicleControl.steer``)."""
    throttle: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
    """Throttle, 0 to 1."""
    brake: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
    """Brake, 0 to 1; it wins over the throttle."""


class Start(Message):
    """Where and how fast a trial begins, relative to the approach's lane."""

    distance: Finite
    """From the body's centre to the stop line along the lane, metres. Negative only in a cruise: the car starts that
    far past the stop line, on the route's path through the junction."""
    speed: Annotated[float, Field(ge=0, le=22, allow_inf_nan=False)]
    """Metres a second."""
    lateral: Finite
    """Offset from the lane's centre line, metres, positive to the left."""
    yaw: Finite
    """Heading relative to the lane's, radians, positive to the left."""


class Traffic(Message):
    """How many other road users share the town; a town too small for them is refused by name when the trial begins."""

    vehicles: Annotated[int, Field(ge=0, le=200)] = 0
    pedestrians: Annotated[int, Field(ge=0, le=200)] = 0


class Fault(Message):
    """What is done to the command, and when. Parameters that a kind does not use stay None."""

    kind: FaultKind
    onset: Finite | None = None
    """Where it sets in, metres along the route from the nominal window's begin."""
    duration: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """How long it lasts, seconds."""
    severity: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] | None = None
    """How bad it is, 0 to 1; what that means is the kind's own."""


class Journey(Message):
    """A drive over any number of junctions, to a goal (CoRL 2017's tasks) or about the town."""

    task: Task
    goal: str | None = None
    """The lane on which the goal lies; None where there is none: then each junction's exit is drawn from the seed."""
    goal_at: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """How far along that lane, metres."""
    length: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Of the shortest way from the start to the goal, metres."""
    time_limit: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    """Seconds; with a goal what the shortest way takes at 10 km/h, as CoRL 2017 has it."""

    @model_validator(mode="after")
    def _goal_fits_task(self) -> Self:
        if (self.task is Task.CRUISE) != (self.goal is None):
            raise ValueError(f"goal: a {self.task} {'has none' if self.goal else 'needs one'}")
        return self


class Trial(Message):
    """One test: where a car starts, where its route leads, and what is done to its command.

    A trial with a journey begins before the approach named and goes on past its junction; ``route`` is then the
    shortest way's direction there.
    """

    id: str
    """Readable and stable, such as ``Town01.J3-S.infeasible.s17``."""
    town: str
    approach: str
    """The arm by which the car drives in, such as ``J3-S``: junction J3 from its southern arm."""
    junction_type: JunctionType
    route: Command
    """The direction that the route takes at the junction."""
    start: Start
    weather: Weather = Weather.CLEAR_NOON
    traffic: Traffic = Traffic()
    fault: Fault
    seed: Seed
    """What every random draw of the episode comes from."""
    journey: Journey | None = Field(default=None, exclude_if=is_none)
    """Of a drive across the town; None where one junction is all there is to it."""

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
        """Whether it is the faultless one of a pair."""
        return self.fault.kind is FaultKind.NONE and self.journey is None

    def twin(self) -> "Trial":
        """The same trial with the fault ``none``."""
        return self.model_copy(update={"id": twin_id(self), "fault": Fault(kind=FaultKind.NONE)})


def trial_id(town: str, approach: str, fault: FaultKind, seed: int) -> str:
    """The readable name of a trial."""
    return f"{town}.{approach}.{fault}.s{seed}"


def twin_id(trial: Trial) -> str:
    """The name of a trial's twin."""
    return trial_id(trial.town, trial.approach, FaultKind.NONE, trial.seed)


class PracticeRequest(Message):
    """``POST /v1/episodes``: an episode for practice, never scored.

    Either ``suite`` and ``trial`` name a trial of an open split, or ``town`` and ``approach`` with the rest describe
    one, or ``town`` and ``task`` a journey (and its first ``approach``, if that matters); what is left out is drawn
    from the seed by the suites' own recipe.
    """

    suite: str | None = None
    trial: str | None = None
    town: str | None = None
    approach: str | None = None
    task: Task | None = None
    """Of a journey."""
    route: Literal[Command.LEFT, Command.RIGHT, Command.STRAIGHT] | None = None
    fault: Fault | FaultKind = FaultKind.NONE
    weather: Weather = Weather.CLEAR_NOON
    traffic: Traffic = Traffic()
    seed: Seed = 0
    track: Track = Track.STATE

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


class EpisodeReply(Message):
    """201 to a reset."""

    id: str
    """Opaque: it tells nothing of the trial."""
    seq: Literal[0] = 0
    observation: ObservationMessage
    town: str | None = None
    """The town's name, in the privileged track and in practice."""
    trial: str | None = None
    """The trial's id, in practice only."""
    lease_expires_in_s: float


class StepRequest(Message):
    """``POST /v1/episodes/{id}/step``."""

    seq: Annotated[int, Field(ge=1)]
    """The last one received plus 1."""
    action: Action


class StepReply(Message):
    """200 to a step."""

    seq: int
    observation: ObservationMessage
    terminated: bool
    """The episode has its verdict."""
    truncated: bool
    """Time ran out."""
    reward: float | None = None
    """In practice only."""
    verdict: Verdict | None = None
    """In practice only, with the last step."""


class JourneyOutcome(Message):
    """What a journey came to, beside its verdict."""

    distance: float
    """Driven, metres."""
    completion: float
    """Share of the shortest way that was covered, 0 to 1; 1 without a goal."""
    junctions: int
    """Passed by an exit that was permitted."""
    off_road: int
    """Times the car left the road: its centre, or three or more wheels."""
    wrong_lane: int
    """Times its centre came into an oncoming lane."""
    collisions: int
    """0 or 1: a journey ends with the first."""

    @property
    def clean(self) -> bool:
        """Whether it was driven without any infraction."""
        return not (self.off_road or self.wrong_lane or self.collisions)


class Outcome(Message):
    """What the judge found."""

    verdict: Verdict
    reaction: Reaction | None = None
    """To ``infeasible`` and ``omission``; None where there is no fault."""
    flags: tuple[Flag, ...] = ()
    """Sorted, each once."""
    exit: Command | None = None
    """The direction of the exit that was taken."""
    time: float
    """When the verdict fell, seconds."""
    min_ttc: float | None = None
    """Least time to collision with what the car was closing in on, seconds; None where it closed in on nothing."""
    max_deceleration: float
    """Hardest deceleration, metres per second squared."""
    journey: JourneyOutcome | None = Field(default=None, exclude_if=is_none)
    """Of a trial with a journey."""


class EpisodeDetail(Message):
    """``GET /v1/episodes/{id}``."""

    id: str
    state: EpisodeState
    seq: int
    """Of the last reply."""
    evaluation: str | None = None
    last_reply: dict[str, Any] | None = None
    """The reply to the last call while the episode is open."""
    trial: str | None = None
    """Once it may be shown."""
    outcome: Outcome | None = None
    """Once it may be shown."""
    trajectory_sha256: str | None = None
    """Of the trajectory's canonical JSON, once it may be shown."""
    actions_sha256: str | None = None
    """Of the actions as little-endian float32 [n, 3] in the order steer, throttle, brake; once it may be shown."""
