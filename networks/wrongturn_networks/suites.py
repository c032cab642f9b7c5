"""Suites: versioned, immutable lists of trials."""

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from pydantic import ValidationError

from wrongturn_networks.errors import CorruptFileError, UnknownSuiteError, UnknownTrialError
from wrongturn_protocol import SuiteSummary, Track, Trial, TrialDetail, TrialList

SUITES: Final = Path(__file__).parent / "suites"


@dataclass(frozen=True, eq=False)
class Suite:
    """A versioned list of trials with its checksum."""

    id: str
    """Name and version. Example: ``wrong-command@1``."""
    name: str
    version: int
    title: str
    sha256: str
    """Checksum of the canonical JSON of its content."""
    tracks: tuple[Track, ...]
    """Tracks in which it can be driven for a score."""
    trials: tuple[Trial, ...]
    """Trials, without their twins."""

    @cached_property
    def episodes(self) -> tuple[Trial, ...]:
        """Trials that an evaluation drives: each one and its twin; journeys have no twin."""
        return tuple(
            episode for trial in self.trials for episode in ((trial,) if trial.journey else (trial, trial.twin()))
        )

    @cached_property
    def _by_id(self) -> Mapping[str, Trial]:
        return MappingProxyType({trial.id: trial for trial in self.episodes})

    def trial(self, trial_id: str) -> Trial:
        """Return the trial or twin with an id.

        Raises:
            UnknownTrialError: the suite has no such trial.
        """
        if trial_id not in self._by_id:
            raise UnknownTrialError(trial_id, self._by_id)
        return self._by_id[trial_id]

    def summary(self) -> SuiteSummary:
        """Return the suite as the service lists it."""
        return SuiteSummary(
            id=self.id,
            title=self.title,
            version=self.version,
            sha256=self.sha256,
            trials=len(self.trials),
            twins=len(self.episodes) - len(self.trials),
            tracks=self.tracks,
        )

    def trial_list(self) -> TrialList:
        """Return the trials as the service lists them, each with its twin's id if it has one."""
        return TrialList(
            trials=tuple(
                TrialDetail.model_validate({**trial.model_dump(), "twin": None if trial.journey else trial.twin().id})
                for trial in self.trials
            )
        )


def canonical(content: Mapping[str, Any]) -> bytes:
    """Return a suite's content as sorted JSON without white space, for its checksum."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def suite_ids() -> tuple[str, ...]:
    """Return the ids of all suites, sorted."""
    return tuple(sorted(path.stem for path in SUITES.glob("*@*.json")))


def load_suite(suite_id: str) -> Suite:
    """Return a suite by its id; each process reads it once.

    Raises:
        UnknownSuiteError: there is no such suite; the message lists the known ones.
        CorruptFileError: its file does not match its checksum.
    """
    # The id may come from a stranger and becomes a path, so it must be a listed one.
    known = suite_ids()
    if suite_id not in known:
        raise UnknownSuiteError(suite_id, known)
    return _shipped(suite_id)


@functools.lru_cache(maxsize=64)
def _shipped(suite_id: str) -> Suite:
    return read_suite(SUITES / f"{suite_id}.json")


def read_suite(path: Path) -> Suite:
    """Return the suite in a file.

    Raises:
        CorruptFileError: the file was changed, or is not a suite.
    """
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
        return Suite(
            id=path.stem,
            name=content["name"],
            version=content["version"],
            title=content["title"],
            sha256=sha256,
            tracks=tuple(Track(track) for track in content["tracks"]),
            trials=tuple(Trial.model_validate(trial) for trial in content["trials"]),
        )
    except (
        OSError,
        json.JSONDecodeError,
        UnicodeDecodeError,
        KeyError,
        AttributeError,
        TypeError,
        ValidationError,
    ) as error:
        raise CorruptFileError(f"suite {path.stem}: {error}; install wrongturn-networks again") from error
