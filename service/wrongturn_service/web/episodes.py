"""The page of an episode: what the car did, beside its twin."""

import asyncio
import gzip
from typing import NamedTuple

from fastapi import APIRouter, Request, Response

from wrongturn_protocol import ProblemType
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep, tagged
from wrongturn_service.encoding import Encoding
from wrongturn_service.errors import NotFoundError, ServiceError
from wrongturn_service.replays import check_town
from wrongturn_service.service import Service
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.web import words
from wrongturn_service.web.drives import Moment, drive, moments
from wrongturn_service.web.forks import forks_of, told
from wrongturn_service.web.page import SECURITY, page

router = APIRouter(include_in_schema=False)


class Shown(NamedTuple):
    """An episode as the page shows it."""

    episode: FinishedEpisode
    name: str
    """What the page calls it."""
    moments: list[Moment]
    """Empty without a trajectory that can be shown."""
    missing: str | None
    """Why it cannot be replayed."""


@router.api_route("/episodes/{episode}", methods=["GET", "HEAD"])
async def show(request: Request, service: ServiceDep, episode: str, fork: str | None = None) -> Response:
    """Show a finished episode of a finished evaluation, beside its twin and a fork."""
    found = await _found(service, episode)
    driven = await service.finished.evaluation(found.evaluation)
    assert driven is not None
    evaluation, agent = driven
    pair = await service.finished.counterpart(found)
    forks = forks_of(found.outcome, await service.finished.forks(found.id), fork)
    drives = [await _shown(service, one) for one in (found, pair, forks.shown) if one is not None]
    if forks.no_return is not None and drives[0].moments:
        drives[0].moments.append(forks.no_return)
        drives[0].moments.sort(key=lambda moment: moment.decision)
    return page(
        request,
        "episode.html",
        drives=drives,
        twin=pair,
        forks=forks,
        told=told,
        evaluation=evaluation,
        agent=agent,
        words=words,
    )


@router.api_route("/episodes/{episode}/drive.json", methods=["GET", "HEAD"])
async def rows(request: Request, service: ServiceDep, episode: str) -> Response:
    """Send what the page's scripts draw."""
    found = await _found(service, episode, forks=True)
    body = await service.replays.made("drive", found.id, drive)
    headers = {**SECURITY, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
    if "gzip" in request.headers.get("accept-encoding", ""):
        headers["Content-Encoding"] = "gzip"
    else:
        body = await asyncio.to_thread(gzip.decompress, body)
    return tagged(request, body, Encoding.JSON, headers)


@router.api_route("/episodes/{episode}/film.mp4", methods=["GET", "HEAD"])
async def film(request: Request, service: ServiceDep, episode: str) -> Response:
    """Send a finished episode as a film."""
    found = await _found(service, episode, forks=True)
    driven = await service.finished.evaluation(found.evaluation)
    assert driven is not None
    body = await service.replays.film(found.id, found.outcome, driven[1].name)
    return tagged(request, body, "video/mp4", {**SECURITY, "Cache-Control": "no-cache"})


async def _found(service: Service, episode: str, *, forks: bool = False) -> FinishedEpisode:
    found = await service.finished.episode(episode)
    if found is None and forks:
        found = next((one for one in await service.finished.forks(episode) if one.id == episode), None)
    if found is None:
        raise NotFoundError(
            ProblemType.UNKNOWN_EPISODE,
            f"there is no episode {episode[:64]!r} to show; an episode is shown once its whole evaluation is finished",
        )
    return found


async def _shown(service: Service, episode: FinishedEpisode) -> Shown:
    trial = episode.trial
    name = "The twin, without a fault" if trial.is_twin else "The trial, with the fault"
    if trial.journey is not None:
        name = "The journey"
    if trial.fork is not None:
        name = f"What if: {told(episode)}"
    found: list[Moment] = []
    missing = None
    try:
        town = catalogue.town_driven(trial)
        trajectory = await service.replays.trajectory(episode.id)
        check_town(trajectory)
        found = await asyncio.to_thread(moments, trajectory, episode.outcome, town)
    except ServiceError as error:
        missing = error.detail
    return Shown(episode, name, found, missing)
