"""Drives an agent's trials again, and makes its part of the study and its films."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from statistics import median
from typing import Final

from lab.failures import (
    Ended,
    Film,
    FilmedJourney,
    FilmedWay,
    MeasuredDrive,
    Measures,
    Way,
)
from lab.filming.journeys import contact_of, drive_journey, journeys
from lab.filming.measures import decision_before_line, measure
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_agents.training.export.export import sha256
from wrongturn_agents.training.in_process import DrivenEpisode, drive_in_process
from wrongturn_protocol import Condition, FaultKind, JunctionType, Trial, Verdict, View
from wrongturn_protocol.episodes import twin_id
from wrongturn_sim import Replay
from wrongturn_sim.view.film import write_film

Cell = tuple[JunctionType, FaultKind]
Progress = Callable[[int, int], None]
SIZE: Final = 280
"""Side of the view from above, pixels."""
EVERY: Final = 2
"""Every second decision is a frame."""
_RATE: Final = 10 // EVERY
"""Frames a second."""
_RUN_UP: Final = 10.0
"""Metres before the stop line at which a film begins."""
MOST: Final = 6
"""Films of an agent: its most frequent ways have one, so that an agent that cannot drive does not fill the page."""
INSTEAD: Final = 2
"""Films of an agent without an unsafe trial."""
_LONGEST_S: Final = 7.0
"""Seconds of the longest film, which shows the end."""


class Filmer:
    """Drives an agent and films it.

    Args:
        source: the agent.
        directory: directory of the films.
        threads: threads that share the simulation.
        progress: called with the numbers of finished and of all drives.
    """

    def __init__(self, source: AgentSource, directory: Path, threads: int, progress: Progress) -> None:
        self._source, self.directory = source, directory
        self._threads, self._progress = threads, progress
        self._driven: dict[str, DrivenEpisode] = {}

    def drive_open_draw(self) -> Ended:
        """Return how the agent ends the trials of the open draw, without their twins.

        Raises:
            AgentsError: the agent cannot be made, or fails.
        """
        trials = [trial for trial in installed_suite(WRONG_COMMAND).trials.values() if not trial.is_twin]
        self._drive(trials)
        return Ended(WRONG_COMMAND, {trial.id: _result(self._driven[trial.id]) for trial in trials})

    def ways(self, ended: Ended, cells: Mapping[Cell, int]) -> tuple[FilmedWay, ...]:
        """Drive the unsafe trials and their twins again, and make a film of each way in which they end.

        Args:
            ended: how the trials ended.
            cells: where other agents fail, and how often. An agent without an unsafe trial is filmed there.

        Raises:
            AgentsError: the agent cannot be made, or fails.
            ResultsError: no trial of a way ends that way again.
        """
        ways = ended.unsafe_ways()
        often = sorted(ways, key=lambda way: -len(ways[way]))[:MOST]
        if not ways:
            ways = {way: names for way, names in ended.ways().items() if way.cell in cells}
            often = sorted(ways, key=lambda way: -cells[way.cell])[:INSTEAD]
        trials = installed_suite(WRONG_COMMAND, ended.secret).trials
        names = [name for of_way in ways.values() for name in of_way]
        wanted = dict.fromkeys([*names, *(twin_id(trials[name]) for name in names)])
        self._drive([trials[name] for name in wanted])
        return tuple(self._way(way, of, filmed=way in often) for way, of in ways.items())

    def _way(self, way: Way, names: tuple[str, ...], *, filmed: bool) -> FilmedWay:
        """Return what was measured of a way, with its film if it has one."""
        again = [self._driven[name] for name in names]
        alike = [one for one in again if Way.of(one.trial, _result(one)) == way]
        if not alike:
            raise ResultsError(
                f"{self._source.name}: none of {', '.join(names)} ends in {way.ending} again; its results are of other "
                "weights, or of another machine: drive it over the service again and import the run"
            )
        drives = {
            one.trial.id: MeasuredDrive(
                trial=one.trial.id, own=_measured(one), twin=_measured(self._driven[twin_id(one.trial)])
            )
            for one in alike
        }
        return FilmedWay(
            **way._asdict(),
            trials=names,
            drives=tuple(drives.values()),
            film=self._film_of_way(way, min(alike, key=lambda one: _rank(one.trial.id, drives))) if filmed else None,
        )

    def _film_of_way(self, way: Way, driven: DrivenEpisode) -> Film:
        first = decision_before_line(driven.trajectory, _RUN_UP)
        return _film(driven, self.directory / way.film(self._source.name), first)

    def _drive(self, trials: Iterable[Trial]) -> None:
        """Drive those trials that have not been driven yet."""
        missing = [trial for trial in trials if trial.id not in self._driven]
        for one in drive_in_process(self._source, missing, threads=self._threads, progress=self._progress):
            self._driven[one.trial.id] = one

    def journeys(self) -> tuple[FilmedJourney, ...]:
        """Drive journeys beside SUMO's traffic, and make a film of the most frequent kind of collision.

        Raises:
            AgentsError: the agent cannot be made, or fails.
        """
        trials = journeys()
        found: dict[str, FilmedJourney] = {}
        self._progress(0, len(trials))
        for number, trial in enumerate(trials, 1):
            self._driven[trial.id] = drive_journey(self._source, trial)
            found[trial.id] = _journey(self._driven[trial.id])
            self._progress(number, len(trials))
        kinds = Counter(one.contact.other for one in found.values() if one.contact is not None)
        for kind, _ in kinds.most_common(1):
            shown = next(one for one in found.values() if one.contact is not None and one.contact.other is kind)
            driven = self._driven[shown.trial]
            film = _film(driven, self.directory / f"{self._source.name}.traffic.webp")
            found[shown.trial] = shown.model_copy(update={"film": film})
        return tuple(found.values())


def _rank(trial: str, drives: Mapping[str, MeasuredDrive]) -> tuple[float, str]:
    """Return a sort key: the drive that is nearest to the middle of all comes first."""
    return _oddness(drives[trial].own, drives.values()), trial


def _oddness(own: Measures, all_of_them: Iterable[MeasuredDrive]) -> float:
    """Return how far a drive is from the median one: metres and m/s count alike."""
    others = [one.own for one in all_of_them]

    def away(value: Callable[[Measures], float | None]) -> float:
        known = [number for one in others if (number := value(one)) is not None]
        mine = value(own)
        return 0.0 if mine is None or not known else abs(mine - median(known))

    return (
        away(lambda one: one.line_speed)
        + away(lambda one: one.past_middle)
        + away(lambda one: one.left)
        + away(lambda one: one.turned / 10.0)
    )


def _journey(driven: DrivenEpisode) -> FilmedJourney:
    trial, outcome = driven.trial, driven.outcome
    assert outcome is not None  # the drive was to its end
    return FilmedJourney(
        trial=trial.id,
        condition=Condition.of(trial.town, trial.weather),
        verdict=outcome.verdict,
        contact=contact_of(driven.trajectory) if outcome.verdict is Verdict.COLLISION else None,
    )


def _film(driven: DrivenEpisode, file: Path, first: int = 0) -> Film:
    replay = Replay(driven.trajectory, driven.outcome)
    first = max(first, len(replay) - round(10 * _LONGEST_S))
    write_film(file, replay.frames(View.BOTH, SIZE, first=first, every=EVERY), rate=_RATE, small=True)
    return Film(file=file.name, sha256=sha256(file), trial=driven.trial.id)


def _result(driven: DrivenEpisode) -> TrialResult:
    assert driven.outcome is not None  # each drive ends with its verdict
    return TrialResult.of(driven.outcome)


def _measured(driven: DrivenEpisode) -> Measures:
    assert driven.outcome is not None
    return measure(driven.trajectory, driven.outcome)
