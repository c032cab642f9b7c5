"""Drives that were recorded elsewhere, and what the judge says of them. The page docs/judge.md explains both."""

from typing import Annotated, Final, Literal, TypeVar

from pydantic import Field

from wrongturn_protocol.episodes import WATCH, Message, Outcome, ScenerySeed
from wrongturn_protocol.vocabulary import FaultKind, Verdict

MOST_ROWS: Final = 20_000
_T = TypeVar("_T")
_Rows = Annotated[tuple[_T, ...], Field(min_length=2, max_length=MOST_ROWS)]
_Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
_Time = Annotated[float, Field(ge=0, le=1e10, allow_inf_nan=False)]
_Positive = Annotated[float, Field(ge=0, le=1e3, allow_inf_nan=False)]
_Command = Literal["LEFT", "RIGHT", "STRAIGHT", "LANE_FOLLOW", "VOID"]


class RecordedUser(Message):
    """Another road user: its size in metres, and for each row its middle, heading and speed; null where it is away."""

    length: _Positive
    width: _Positive
    x: _Rows[_Number | None]
    y: _Rows[_Number | None]
    yaw: _Rows[_Number | None]
    speed: _Rows[_Positive | None]


class Recording(Message):
    """One drive through a junction: a header that says what the numbers mean, and a list for each column.

    The docstrings continue an error: "frame: missing; give town (x east, …) or carla".
    """

    town: str
    """a town's name; 'wrongturn towns' lists them"""
    approach: str
    """the arm by which the car enters, such as J3-S; 'wrongturn towns TOWN' lists them"""
    frame: Literal["town", "carla"]
    """town (x east, y north, yaw counter-clockwise from east) or carla (y south, yaw clockwise)"""
    units: Literal["m s rad m/s", "m s rad km/h", "m s deg m/s", "m s deg km/h"]
    """units of length, time, angle and speed: 'm s rad m/s', or with deg or km/h in their places"""
    reference: Literal["centre", "rear_axle", "front_bumper"]
    """the point of the car that x and y tell: centre (of the body), rear_axle or front_bumper"""
    length: Annotated[float, Field(ge=2, le=5.6, allow_inf_nan=False)]
    """the car's length, 2 to 5.6 m; the judge knows no trucks"""
    width: Annotated[float, Field(ge=1, le=2.1, allow_inf_nan=False)]
    """the car's width, 1 to 2.1 m"""
    rear_axle: Annotated[float, Field(ge=0.5, le=2.5, allow_inf_nan=False)] | None = None
    """metres from the rear axle to the body's centre, 0.5 to 2.5; needed if reference is rear_axle"""
    command: _Command | None = None
    """the command that the agent was given: LEFT, RIGHT, STRAIGHT, LANE_FOLLOW or VOID"""
    command_at: _Time | None = None
    """when it was given, seconds on the clock of t; before it LANE_FOLLOW. By default it was from the start on"""
    route: Literal["LEFT", "RIGHT", "STRAIGHT"] | None = None
    """where the route goes, an exit of the approach: LEFT, RIGHT or STRAIGHT"""
    fault: FaultKind = FaultKind.NONE
    """what was done to the command, a fault of docs/faults.md; none by default"""
    watch: Annotated[float, Field(ge=1, le=4, allow_inf_nan=False)] = WATCH
    """for how long the drive is watched after an exit, 1 to 4 s"""
    scenery: ScenerySeed | None = None
    """the seed of drawn scenery; without it the town has what it ships with"""
    t: _Rows[_Time]
    x: _Rows[_Number]
    y: _Rows[_Number]
    yaw: _Rows[_Number]
    speed: _Rows[_Positive]
    commands: _Rows[_Command] | None = None
    """in place of command, what holds from each row on: LEFT, RIGHT, STRAIGHT, LANE_FOLLOW or VOID"""
    others: Annotated[tuple[RecordedUser, ...], Field(max_length=400)] | None = None
    """the other road users as a list in JSON, empty if there were none; in CSV 'none' for none"""


class Judgement(Message):
    """What the judge says of a recording. It is never ranked."""

    verdict: Verdict | None = None
    """None if the recording ends before it is decided."""
    unsafe: bool | None = None
    unsafe_strict: bool | None = None
    severity_mps: float | None = None
    """Speed at the verdict of a drive that is unsafe in the strict column, m/s."""
    seconds_more: float | None = None
    """How many more seconds decide an undecided drive at the latest."""
    outcome: Outcome | None = None
    """Verdict, reaction, flags, lengths and times, as an episode has them."""
    notes: tuple[str, ...] = ()
    """What was not judged, what was assumed, and what is missing."""
