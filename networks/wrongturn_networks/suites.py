"""Suites: versioned and immutable. A suite lists its trials, or the cells from which each evaluation draws its own."""

import dataclasses
import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from wrongturn_networks.drawn import build_towns
from wrongturn_networks.draws import Draw, draw_cells, is_drawn_cell, town_names_of
from wrongturn_networks.errors import CorruptFileError, UnknownSuiteError
from wrongturn_networks.loading import load_town
from wrongturn_networks.shelf import Shelf
from wrongturn_protocol import Cell, SuiteDetail, SuiteSummary, Track, Trial, TrialDetail, TrialList, twin_id
from wrongturn_protocol.home import home

SUITES: Final = Path(__file__).parent / "suites"


@dataclass(frozen=True, eq=False)
class Suite:
    """A versioned list of trials, or of cells to draw trials from, with its checksum."""

    id: str
    """Name and version. Example: ``wrong-command@3``."""
    name: str
    version: int
    title: str
    sha256: str
    """Checksum of the canonical JSON of its content."""
    tracks: tuple[Track, ...]
    """Tracks in which it can be driven for a score."""
    listed: tuple[Trial, ...] = ()
    """Trials without their twins, if the suite lists them."""
    cells: tuple[Cell, ...] = ()
    """Cells, if each evaluation draws its own trials."""
    towns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Checksums of its towns that do not ship with this package, by their names."""

    def draw(self, secret: str) -> Draw:
        """Return the trials that a secret (any text) makes of the cells; the listed ones for a suite without cells.

        Towns that the secret makes are built where they are missing, in several processes.

        Raises:
            SecretError: the secret is empty, or is not text in UTF-8.
            UnknownTownError: a cell names a town that does not exist.
            ApproachTooShortError: no approach of a cell's type has room for a start.
            TownBuildError: a town cannot be built.
        """
        if self.cells:
            build_towns(self.drawn_towns(secret))
            return draw_cells(self.id, self.cells, secret)
        return Draw(self.id, self.listed, tuple(trial.twin() for trial in self.listed if trial.journey is None))

    @cached_property
    def open_draw(self) -> Draw:
        """Draw for development and for comparing training seeds. Its secret is the suite's id; it is never ranked."""
        return self.draw(self.id)

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Trials of the open draw, without their twins."""
        return self.open_draw.trials

    @property
    def episodes(self) -> tuple[Trial, ...]:
        """Trials of the open draw and their twins; journeys have no twin."""
        return self.open_draw.episodes

    def trial(self, trial_id: str) -> Trial:
        """Return the trial or twin of the open draw with an id. Raises UnknownTrialError if there is none."""
        return self.open_draw.trial(trial_id)

    def drawn_towns(self, secret: str) -> tuple[str, ...]:
        """Return the names of the towns that a secret makes for this suite; building them is what takes a draw's time.

        Raises SecretError.
        """
        return tuple(town_names_of(self.cells, secret).values())

    @property
    def makes_towns(self) -> bool:
        """Whether each evaluation drives in towns that its secret makes."""
        return any(map(is_drawn_cell, self.cells))

    @property
    def counts(self) -> tuple[int, int]:
        """Number of trials, and of twins."""
        twins = sum(cell.task is None for cell in self.cells) + sum(trial.journey is None for trial in self.listed)
        return len(self.cells or self.listed), twins

    @property
    def of_journeys(self) -> bool:
        """Whether it consists of journeys, which have no twins."""
        return self.counts[1] == 0

    def summary(self) -> SuiteSummary:
        """Return the suite as the service lists it."""
        trials, twins = self.counts
        return SuiteSummary(
            id=self.id,
            title=self.title,
            version=self.version,
            sha256=self.sha256,
            trials=trials,
            twins=twins,
            tracks=self.tracks,
        )

    def detail(self) -> SuiteDetail:
        """Return the suite as the service shows it alone, with its cells."""
        return SuiteDetail(**self.summary().model_dump(), cells=self.cells)

    def trial_list(self, draw: Draw | None = None) -> TrialList:
        """Return the trials of a draw, by default the open one, as the service lists them, with the ids of twins."""
        return TrialList(
            trials=tuple(
                TrialDetail.model_validate({**trial.model_dump(), "twin": None if trial.journey else twin_id(trial)})
                for trial in (draw or self.open_draw).trials
            ),
            draw="open" if self.cells else "listed",
        )


def canonical(content: Mapping[str, Any]) -> bytes:
    """Return a suite's content as sorted JSON without white space, for its checksum."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def suite_ids() -> tuple[str, ...]:
    """Return the ids of all suites, those of other packages included, sorted."""
    return shelf().names()


def load_suite(suite_id: str) -> Suite:
    """Return a suite, which each process reads once. Raises UnknownSuiteError, or CorruptFileError for a bad file."""
    return shelf().load(suite_id)


def read_suite(path: Path) -> Suite:
    """Return the suite in a file. Raises CorruptFileError if the file was changed, or is not a suite."""
    try:
        content = json.loads(path.read_text("utf-8"))
        sha256 = content.pop("sha256")
        if hashlib.sha256(canonical(content)).hexdigest() != sha256:
            raise CorruptFileError(
                f"suite {path.stem}: the file was changed, and suites never change; "
                "restore it, or give the changed one a new version"
            )
        if f"{content['name']}@{content['version']}" != path.stem:
            raise CorruptFileError(
                f"suite {path.stem}: the file holds {content['name']}@{content['version']}; give it its own name back"
            )
        if bool(content.get("trials")) == bool(content.get("cells")):
            raise CorruptFileError(f"suite {path.stem}: give the file either trials or cells, and at least one")
        return Suite(
            id=path.stem,
            name=content["name"],
            version=content["version"],
            title=content["title"],
            sha256=sha256,
            tracks=_takes(content["tracks"]),
            listed=tuple(Trial.model_validate(trial) for trial in content.get("trials", ())),
            cells=tuple(Cell.model_validate(cell) for cell in content.get("cells", ())),
            towns=MappingProxyType({str(town): str(told) for town, told in content.get("towns", {}).items()}),
        )
    except CorruptFileError:
        raise
    except KeyError as error:
        raise CorruptFileError(
            f"suite {path.stem}: {error} is missing; write the file with wrongturn_networks.making.write_suite"
        ) from error
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise CorruptFileError(f"suite {path.stem}: {error}; install its package again") from error


def _takes(tracks: Sequence[str]) -> tuple[Track, ...]:
    """Return the tracks of a suite's file, and ``words`` with ``camera``: suites never change, and it came later."""
    return tuple(each for track in map(Track, tracks) for each in (track, Track.WORDS)[: 1 + (track is Track.CAMERA)])


def check_suite(suite: Suite) -> None:
    """Check that the trials of the open draw can be driven, unless towns have to be built. Raises NetworkError."""
    for town, told in suite.towns.items():
        if load_town(town).sha256 != told:
            raise CorruptFileError(
                f"suite {suite.id}: the town {town} is not the one that the suite was made for; bring that one "
                "back, or make a suite with a new version"
            )
    if suite.makes_towns:
        return
    from wrongturn_networks.faults import check_fault  # noqa: PLC0415 - loads all faults

    for trial in suite.episodes:
        approach = load_town(trial.town).approach(trial.approach)
        if trial.junction_type is not approach.type:
            raise CorruptFileError(
                f"suite {suite.id}: {trial.id} has the junction type {trial.junction_type}, and its approach is "
                f"{approach.type}; write the file again"
            )
        check_fault(trial)


@functools.cache
def shelf() -> Shelf[Suite]:
    """Return all suites by their ids."""
    return Shelf(
        "wrongturn.suites",
        SUITES.glob("*@*.json"),
        read_suite,
        UnknownSuiteError,
        lambda: sorted((home() / "suites").glob("*@*.json")),
        "WRONGTURN_SUITES",
        check_suite,
    )


def suite_named(text: str) -> str:
    """Return the id of the suite that a user names by its id or its file, which is then known by its id.

    Raises NetworkError for a file that is no suite.
    """
    return shelf().name_of(text)
