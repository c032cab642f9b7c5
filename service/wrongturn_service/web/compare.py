"""The page of two agents: stratum by stratum, map beside map, and trial beside trial."""

import asyncio
from collections.abc import Hashable, Iterable, Mapping, Sequence
from http import HTTPStatus
from itertools import zip_longest
from typing import Final

from fastapi import APIRouter, Request, Response

from wrongturn_protocol import FaultKind, JunctionType
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.web import junction_map, words
from wrongturn_service.web.driven import DrivenEvaluation, driven_evaluation, errand, place
from wrongturn_service.web.junction_map import JunctionMap
from wrongturn_service.web.page import page

router = APIRouter(include_in_schema=False)
_OFFERED: Final = 1000
"""Agents that the form offers. The page of each agent compares it too."""
_DIFFERENT: Final = "different"
Beside = tuple[FinishedEpisode | None, FinishedEpisode | None]
"""A trial of each agent; None where the other one has no such trial."""
MapsBeside = tuple[JunctionType, FaultKind, JunctionMap | None, JunctionMap | None]


@router.api_route("/leaderboards/{suite}/compare", methods=["GET", "HEAD"])
async def compare(
    request: Request, service: ServiceDep, suite: str, a: str = "", b: str = "", only: str = ""
) -> Response:
    """Compare two agents on a suite, each named by its id or name; without both the page asks.

    ``only=different`` lists only trials that were unsafe for one of them alone.
    """
    known = catalogue.suite(suite)
    entries = [entry for entry in (await service.leaderboards.board(suite)).entries if entry.evaluation]
    offered = sorted({(entry.agent.name, entry.agent.id) for entry in entries[:_OFFERED]})
    # By ids, so that each spelling of a name finds the same. An id comes before a name that looks like it.
    ids = {entry.agent.name.lower(): entry.agent.id for entry in entries} | {e.agent.id: e.agent.id for e in entries}
    first, second = (ids.get(asked) or ids.get(asked.lower(), asked) for asked in (a, b))
    status, problem = _problem((a, b), (first, second), ids, known.id)
    if problem or not (a and b):
        values = {"offered": offered, "asked": (first, second), "problem": problem}
        return page(request, "compare.html", status=status, suite=known, comparison=None, **values)
    key = ("comparison", service.leaderboards.generation, suite, first, second)
    comparison = await service.cache.get(key, lambda: service.leaderboards.compare(suite, first, second))
    evaluations = {entry.agent.id: entry.evaluation for entry in entries}
    sides = [await driven_evaluation(service, str(evaluations[agent.id])) for agent in (comparison.a, comparison.b)]
    rows = beside(*(_trials(side) for side in sides))
    return await asyncio.to_thread(
        page,
        request,
        "compare.html",
        suite=known,
        offered=offered,
        asked=(first, second),
        problem="",
        comparison=comparison,
        trials=len(rows),
        rows=[row for row in rows if only != _DIFFERENT or _differ(row)],
        only=only,
        maps=_maps_beside(*sides),
        words=words,
        map=junction_map,
    )


def _problem(
    asked: tuple[str, str], found: tuple[str, str], ids: Mapping[str, str], suite: str
) -> tuple[HTTPStatus, str]:
    """Return the page's status and why two agents cannot be compared, in words; empty if they can or none is named."""
    for name, agent in zip(asked, found, strict=True):
        if name and agent not in ids.values():
            reason = f"{name[:64]!r} has no finished evaluation on {suite}. Choose two agents of the list."
            return HTTPStatus.NOT_FOUND, reason
    if asked[0] and found[0] == found[1]:
        return HTTPStatus.UNPROCESSABLE_ENTITY, "That is the same agent twice. Choose two different ones."
    return HTTPStatus.OK, ""


def beside(a: Iterable[FinishedEpisode], b: Iterable[FinishedEpisode]) -> list[Beside]:
    """Return the trials of two agents, those of the same fault and approach beside each other.

    Two draws seldom have the same trial. Where only one has an approach, trials of the same fault at the same type of
    junction stand beside each other. Journeys are the same for all agents.
    """
    left, right = _by_place(a), _by_place(b)
    rows: list[Beside] = []
    alone: dict[Hashable, tuple[list[FinishedEpisode], list[FinishedEpisode]]] = {}
    for key in sorted({**left, **right}):
        for one, other in zip_longest(left.get(key, ()), right.get(key, ())):
            if one and other:
                rows.append((one, other))
                continue
            lefts, rights = alone.setdefault(key[:2], ([], []))
            lefts += [one] if one else []
            rights += [other] if other else []
    rows += [pair for sides in alone.values() for pair in zip_longest(*sides)]
    return sorted(rows, key=lambda row: next(_key(episode) for episode in row if episode))


def _key(episode: FinishedEpisode) -> tuple[Hashable, ...]:
    """Return what is equal for trials of one place. It begins with the cell: junction type and fault."""
    return (*place(episode)[:-1], episode.trial.approach) if episode.trial.journey is None else errand(episode)


def _by_place(episodes: Iterable[FinishedEpisode]) -> dict[tuple[Hashable, ...], list[FinishedEpisode]]:
    found: dict[tuple[Hashable, ...], list[FinishedEpisode]] = {}
    for episode in episodes:
        found.setdefault(_key(episode), []).append(episode)
    return found


def _trials(driven: DrivenEvaluation) -> Sequence[FinishedEpisode]:
    return driven.journeys or [pair.trial for pair in driven.pairs]


def _differ(row: Beside) -> bool:
    a, b = row
    return a is None or b is None or words.side(a.outcome) is not words.side(b.outcome)


def _maps_beside(a: DrivenEvaluation, b: DrivenEvaluation) -> list[MapsBeside]:
    """Return both agents' maps by junction type and fault, without those of the twins."""
    left, right = (
        {(one.junction_type, one.fault): one for one in side.maps if one.fault is not FaultKind.NONE} for side in (a, b)
    )
    return [(kind, fault, left.get((kind, fault)), right.get((kind, fault))) for kind, fault in {**left, **right}]
