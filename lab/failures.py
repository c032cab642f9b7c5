"""Stored study of how shipped agents fail: what was measured when their trials were driven again, and the films.

``python -m lab.results --failures`` makes it. ``docs/failures.md`` shows it, and needs no driving.
"""

import hashlib
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Final, NamedTuple

from lab.studies import STUDIES, Study, StudyModel
from lab.weights import learned_agents, weights_sha256
from wrongturn_agents.errors import OutdatedPageError
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_protocol import Condition, FaultKind, JunctionType, Reaction, Trial, Verdict

FILMS: Final = Path("docs/pictures/failures")
"""Directory of the films in the repository."""


class Ending(StrEnum):
    """How a drive ended, as far as a reader cares."""

    COLLISION = "collision"
    OFF_ROAD = "off_road"
    STOPPED_IN_JUNCTION = "stopped_in_junction"
    WRONG_WAY = "wrong_way"
    OPPOSED_LANE = "opposed_lane"
    """It ended safely otherwise, but drove far on an opposed lane."""
    EXIT = "exit"
    STOPPED_BEFORE_JUNCTION = "stopped_before_junction"
    ABORTED = "aborted"
    OTHER = "other"

    @classmethod
    def of(cls, result: TrialResult) -> "Ending":
        """Return how a trial ended."""
        if result.unsafe_strict and not result.verdict.unsafe_strict:
            return cls.OPPOSED_LANE
        if result.verdict.exited:
            return cls.EXIT
        return cls.__members__.get(result.verdict.name, cls.OTHER)


class Way(NamedTuple):
    """One way in which trials end: those of one junction type and fault with the same ending and reaction."""

    junction_type: JunctionType
    fault: FaultKind
    ending: Ending
    reaction: Reaction | None

    @classmethod
    def of(cls, trial: Trial, result: TrialResult) -> "Way":
        """Return the way in which a trial ended."""
        return cls(trial.junction_type, trial.fault.kind, Ending.of(result), result.reaction)

    @property
    def cell(self) -> tuple[JunctionType, FaultKind]:
        """Junction type and fault."""
        return self.junction_type, self.fault

    def film(self, agent: str) -> str:
        """Return the name of an agent's film of this way."""
        words = (self.junction_type, self.fault, self.ending, self.reaction or "none")
        return f"{agent}.{'.'.join(str(word).lower().replace('_', '-') for word in words)}.webp"


class Measures(StudyModel):
    """What a trajectory shows, beside the lane that leads to the stop line, extended straight."""

    line_speed: float | None
    """Speed at which the nose crossed the stop line, m/s; None if it never did. So are the next ones."""
    slowest: float | None
    """Least speed past the line, m/s."""
    steer_left: float | None
    """Most steering to the left past the line, 0 to 1."""
    steer_right: float | None
    """Most steering to the right past the line, 0 to 1."""
    beyond_grip_s: float | None
    """Seconds past the line in which the wheels asked for a tighter curve than the grip allows."""
    turn_begins: float | None
    """How far past the line the body's centre was when the car first pointed 10° away from the lane, m; negative
    before the line. None if it never did."""
    turned: float
    """Degrees between the lane and the car at the end, positive to the left."""
    past_middle: float
    """How far past the junction's middle the centre was at the end, m; negative before it."""
    left: float
    """How far left of the lane's axis the centre was at the end, m; negative to the right."""
    end_speed: float
    """Speed at the end, m/s."""
    end_brake: float
    """Brake at the end, 0 to 1."""
    opposed_m: float
    """Distance that the centre was driven on opposed lanes, m."""


class Film(StudyModel):
    """A film in :data:`FILMS`."""

    file: str
    sha256: str
    trial: str
    """Id of the trial that it shows."""


class MeasuredDrive(StudyModel):
    """A trial and its twin, driven again."""

    trial: str
    own: Measures
    twin: Measures


class FilmedWay(StudyModel):
    """One way in which an agent's trials end."""

    junction_type: JunctionType
    fault: FaultKind
    ending: Ending
    reaction: Reaction | None
    trials: tuple[str, ...]
    """Ids of all trials that ended this way."""
    drives: tuple[MeasuredDrive, ...]
    """Those that ended this way again when they were driven again."""
    film: Film | None
    """None if other ways are more frequent, and those are enough."""

    @property
    def way(self) -> Way:
        """The way's name."""
        return Way(self.junction_type, self.fault, self.ending, self.reaction)


class Other(StrEnum):
    """What a car hit, as it was placed."""

    PEDESTRIAN = "pedestrian"
    AHEAD = "ahead"
    """A vehicle that drove or stood ahead, in the same direction."""
    CROSSING = "crossing"
    ONCOMING = "oncoming"
    BEHIND = "behind"
    """A vehicle that drove into the car from behind."""
    SCENERY = "scenery"


class Contact(StudyModel):
    """A collision, and the seconds before."""

    other: Other
    in_junction: bool
    """Whether the car was in a junction."""
    speed: float
    """The car's speed at the collision, m/s."""
    other_speed: float
    """The other's speed, m/s; 0 for scenery."""
    in_view_s: float
    """How long the other had been in the camera's view without a break, within 30 m, seconds."""
    brake: float
    """Mean of the brake in the last two seconds, 0 to 1."""
    throttle: float
    """Mean of the throttle in the last two seconds, 0 to 1."""


class FilmedJourney(StudyModel):
    """A journey beside SUMO's traffic."""

    trial: str
    condition: Condition
    verdict: Verdict
    contact: Contact | None
    """The collision; None if there was none."""
    film: Film | None = None


class FilmedAgent(StudyModel):
    """One agent's ways, each with its film."""

    weights_sha256: str
    secret: str
    """Secret of the draw."""
    results: dict[str, TrialResult] | None
    """How the trials of the open draw ended, for an agent without a file of results; otherwise None."""
    ways: tuple[FilmedWay, ...]
    """The unsafe ways. If no trial is unsafe: what the agent does where others fail."""
    journeys: tuple[FilmedJourney, ...] | None = None
    """Journeys beside traffic; None if they are still to be driven."""


class Failures(Study):
    """How the shipped agents fail."""

    agents: dict[str, FilmedAgent]

    def films(self) -> dict[str, Film]:
        """Return all films by the names of their files."""
        found = [one.film for agent in self.agents.values() for one in agent.ways if one.film is not None]
        found += [one.film for agent in self.agents.values() for one in agent.journeys or () if one.film is not None]
        return {film.file: film for film in found}


class Ended(NamedTuple):
    """How an agent's trials ended."""

    secret: str
    results: Mapping[str, TrialResult]
    """Results of the draw's trials by id."""

    def ways(self) -> dict[Way, tuple[str, ...]]:
        """Return the ways, each with the ids of its trials, sorted. Twins have none."""
        trials = installed_suite(WRONG_COMMAND, self.secret).trials
        found: dict[Way, list[str]] = {}
        for name, result in sorted(self.results.items()):
            if not trials[name].is_twin:
                found.setdefault(Way.of(trials[name], result), []).append(name)
        return {way: tuple(found[way]) for way in sorted(found, key=str)}

    def unsafe_ways(self) -> dict[Way, tuple[str, ...]]:
        """Return the ways that are unsafe in the strict column."""
        return {way: names for way, names in self.ways().items() if self.results[names[0]].unsafe_strict}


def failures_file(directory: Path) -> Path:
    """Return the path of the study in a directory of results."""
    return directory / STUDIES / "failures.json"


def stored_results(collection: Collection, agent: str) -> Ended | None:
    """Return how an agent's trials ended, by its stored results; None if there are none."""
    file = collection.of_shipped(WRONG_COMMAND, agent)
    return None if file is None or file.secret is None else Ended(file.secret, file.trials)


def results_of(collection: Collection, agent: str, filmed: FilmedAgent | None) -> Ended | None:
    """Return how an agent's trials ended: by its stored results, else by the drives for its films; None without."""
    found = stored_results(collection, agent)
    if found is None and filmed is not None and filmed.results is not None:
        return Ended(filmed.secret, filmed.results)
    return found


def outdated(collection: Collection, agent: str, filmed: FilmedAgent) -> str | None:
    """Return why an agent's films do not show it as it is; None if they do."""
    if filmed.weights_sha256 != weights_sha256(agent):
        return "its weights have changed"
    ended = results_of(collection, agent, filmed)
    if ended is None or ended.secret != filmed.secret:
        return "its results have changed"
    trials = {way.way: way.trials for way in filmed.ways}
    found = ended.unsafe_ways() or {way: names for way, names in ended.ways().items() if way in trials}
    return None if found == trials else "its results have changed"


def check_films(collection: Collection, study: Failures | None, directory: Path) -> None:
    """Check that the films are those of the study, and that the study is of the stored results and the weights.

    Raises:
        OutdatedPageError: They are not. The error names the first agent or film.
    """
    if study is None:
        return
    remedy = "make them with 'python -m lab.results --failures --write docs/failures.md'"
    for agent in learned_agents():
        filmed = study.agents.get(agent)
        why = None if filmed is None else outdated(collection, agent, filmed)
        if why is not None:
            raise OutdatedPageError(f"films of {agent}: {why}; {remedy}")
    for film in study.films().values():
        path = directory / film.file
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != film.sha256:
            raise OutdatedPageError(f"{path}: is not the film that was made; {remedy}")
    extra = sorted(path.name for path in directory.glob("*.webp") if path.name not in study.films())
    if extra:
        raise OutdatedPageError(f"{directory / extra[0]}: no page shows it; delete it")
