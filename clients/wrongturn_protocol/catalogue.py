"""Messages about suites, their trials, and towns."""

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints

from wrongturn_protocol.episodes import (
    WATCH,
    Cell,
    Fault,
    Journey,
    Message,
    ScenerySeed,
    Start,
    Traffic,
    is_none,
    is_plain_watch,
)
from wrongturn_protocol.vocabulary import Command, FaultKind, JunctionType, Track, Weather

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]


class SuiteSummary(Message):
    """One suite as ``GET /v1/suites`` lists it."""

    id: str
    """Name and version, such as ``wrong-command@3``."""
    title: str
    version: int
    sha256: Sha256
    trials: int
    """Number of trials, without their twins."""
    twins: int
    tracks: tuple[Track, ...]


class SuiteDetail(SuiteSummary):
    """``GET /v1/suites/{suite}``."""

    cells: tuple[Cell, ...] = ()
    """What each evaluation draws its own trials from, in the order of the open draw's trials. Empty for a suite that
    lists its trials, which are the same for everybody."""


class SuiteList(Message):
    """``GET /v1/suites``."""

    suites: tuple[SuiteSummary, ...]


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
    watch: float = Field(default=WATCH, exclude_if=is_plain_watch)
    """For how long a drive goes on after it took an exit, seconds; JSON leaves 2.0 out."""
    scenery: ScenerySeed | None = Field(default=None, exclude_if=is_none)
    """Seed of the town's drawn scenery. None: the scenery that the town ships with."""
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


class TownList(Message):
    """``GET /v1/towns``."""

    towns: tuple[TownSummary, ...]


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
