"""What an agent did in an evaluation: its trials beside their twins, its journeys, and its junction maps."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import orjson

from wrongturn_networks import load_town, town_names
from wrongturn_networks.drawn import is_drawn
from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType, Task, twin_id
from wrongturn_protocol.junction_frame import Points
from wrongturn_service.service import Service
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.web.junction_map import Driven, JunctionMap, junction_map

_BATCH: Final = 120
"""Trajectories in memory at once. The longest episodes of a junction have about 0.3 MB each."""
_TYPES: Final = (*PAPER_TYPES, JunctionType.CROSS)
"""Types in the order of the paper's table."""
_FAULTS: Final = (*(kind for kind in FaultKind if kind is not FaultKind.NONE), FaultKind.NONE)
"""Faults in the order of the vocabulary. The twins come last."""


class Pair(NamedTuple):
    """A trial and its twin."""

    trial: FinishedEpisode
    twin: FinishedEpisode | None


@dataclass(frozen=True)
class DrivenEvaluation:
    """The episodes of a finished evaluation."""

    pairs: tuple[Pair, ...]
    """Trials by junction type, fault and approach; empty for journeys."""
    journeys: tuple[FinishedEpisode, ...]
    """Journeys by task; empty for other trials."""
    maps: tuple[JunctionMap, ...]
    """By junction type and fault. That of a type's twins is its last."""


async def driven_evaluation(service: Service, evaluation_id: str) -> DrivenEvaluation:
    """Return what was driven in a finished evaluation. It is kept, because it does not change."""
    return await service.cache.get(("driven", evaluation_id), lambda: _load(service, evaluation_id))


async def _load(service: Service, evaluation_id: str) -> DrivenEvaluation:
    episodes = await service.finished.episodes(evaluation_id)
    service.draws.check_towns(episode.trial for episode in episodes)
    junctions = [episode for episode in episodes if episode.trial.journey is None]
    paths: dict[str, Points] = {}
    for first in range(0, len(junctions), _BATCH):
        batch = [episode.id for episode in junctions[first : first + _BATCH]]
        found = await service.finished.trajectories(evaluation_id, batch)
        paths |= await asyncio.to_thread(_paths, found)
    return await asyncio.to_thread(arranged, episodes, paths)


def arranged(episodes: Sequence[FinishedEpisode], paths: Mapping[str, Points]) -> DrivenEvaluation:
    """Arrange an evaluation's episodes for its page.

    ``paths`` says by episode where the car's centre was, (n, 2) in the town's frame.
    """
    by_trial = {episode.trial.id: episode for episode in episodes}
    trials = [episode for episode in episodes if episode.trial.journey is None and not episode.trial.is_twin]
    journeys = [episode for episode in episodes if episode.trial.journey is not None]
    return DrivenEvaluation(
        pairs=tuple(Pair(trial, by_trial.get(twin_id(trial.trial))) for trial in sorted(trials, key=place)),
        journeys=tuple(sorted(journeys, key=errand)),
        maps=_maps([episode for episode in episodes if episode.trial.journey is None], paths),
    )


def _maps(episodes: Sequence[FinishedEpisode], paths: Mapping[str, Points]) -> tuple[JunctionMap, ...]:
    driven: dict[JunctionType, dict[FaultKind, list[Driven]]] = {}
    known = _approaches(episodes)
    for episode in episodes:
        trial = episode.trial
        if (trial.town, trial.approach) not in known:
            continue
        by_fault = driven.setdefault(trial.junction_type, {})
        by_fault.setdefault(trial.fault.kind, []).append((episode, paths.get(episode.id)))
    found: list[JunctionMap] = []
    for kind in sorted(driven, key=_TYPES.index):
        by_fault = driven[kind]
        # All maps of a type show the same roads, so that only the paths differ.
        approaches = {(one.trial.town, one.trial.approach) for some in by_fault.values() for one, _ in some}
        found += (junction_map(kind, fault, approaches, by_fault[fault]) for fault in _FAULTS if fault in by_fault)
    return tuple(found)


def _approaches(episodes: Sequence[FinishedEpisode]) -> set[tuple[str, str]]:
    """Return the approaches, each by town and id, that can be drawn. Old episodes may be of a town that is gone."""
    driven = {episode.trial.town for episode in episodes}
    towns = driven & {*town_names(), *filter(is_drawn, driven)}
    return {(town, approach) for town in towns for approach in load_town(town).approaches}


def _paths(trajectories: Mapping[str, bytes]) -> dict[str, Points]:
    """Return every other point of each path (a tenth of a second apart), and the last one."""
    paths = {}
    for episode, body in trajectories.items():
        columns = orjson.loads(body)
        points = np.column_stack((np.array(columns["x"], float), np.array(columns["y"], float)))
        paths[episode] = np.concatenate((points[:-1:2], points[-1:]))
    return paths


def place(episode: FinishedEpisode) -> tuple[int, int, str, int, str]:
    """Return the order of a trial on a page: by junction type, fault, town, junction and id."""
    trial = episode.trial
    number = trial.approach.partition("-")[0].removeprefix("J")
    return (
        _TYPES.index(trial.junction_type),
        _FAULTS.index(trial.fault.kind),
        trial.town,
        int(number) if number.isdecimal() else 0,
        trial.id,
    )


def errand(episode: FinishedEpisode) -> tuple[int, str, str, str]:
    """Return the order of a journey on a page: by task, town, weather and id."""
    trial = episode.trial
    assert trial.journey is not None
    return list(Task).index(trial.journey.task), trial.town, trial.weather, trial.id
