"""Judgements of drives that were recorded elsewhere, for anybody: few at a time, and nothing is stored."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Request, Response

from wrongturn_judge import JudgeError
from wrongturn_networks import NetworkError
from wrongturn_protocol import Judgement, Recording
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import Body, ServiceDep, reply, weights
from wrongturn_service.api.documents import Route, described
from wrongturn_service.client_address import address_of
from wrongturn_service.errors import InvalidRequestError, too_many
from wrongturn_service.replays import drawn

router = APIRouter(prefix="/v1/judgements", tags=["judgements"], route_class=Route)
_LARGEST: Final = 2 << 20  # 60 s at 100 Hz have 0.6 MB, and 2 MiB are parsed in 25 ms
_PNG: Final = "image/png"
_GIVEN = described(Judgement, 404, 429)
_GIVEN["responses"][200]["content"] = {"application/json": {}, _PNG: {"schema": {"type": "string", "format": "binary"}}}


async def _counted(request: Request, service: ServiceDep) -> AsyncIterator[None]:
    """Count the call from before its body is read until it is answered."""
    address, under_way = address_of(request), service.judgements
    if under_way[address] >= 2 or under_way.total() >= 16:
        raise too_many("2 judgements of this address, or 16 in all, are under way; send one at a time")
    under_way[address] += 1
    try:
        yield
    finally:
        under_way -= Counter([address])


@router.post("", **_GIVEN, dependencies=[Depends(_counted)])
async def judge(
    request: Request, service: ServiceDep, recording: Annotated[Recording, Depends(Body(Recording, limit=_LARGEST))]
) -> Response:
    """Judge a drive that was recorded in another simulator. It is neither stored nor ranked.

    The header says what the numbers mean. Each list has a value for each row, 5 to 100 a second. ``Accept: image/png``
    gets the drive from above in place of the judgement.
    """
    catalogue.town(recording.town)
    wanted = dict(weights(request.headers.get("accept", "")))
    async with service.judging:
        found = await asyncio.to_thread(
            _judged, recording, picture=wanted.get(_PNG, 0) > wanted.get("application/json", 0)
        )
    return found if isinstance(found, Response) else reply(found)


def _judged(recording: Recording, *, picture: bool) -> Judgement | Response:
    # A compiler: the service is ready without it.
    from wrongturn_judge.recordings import judged  # noqa: PLC0415

    try:
        judgement, trajectory = judged(recording)
    except (JudgeError, NetworkError) as error:
        raise InvalidRequestError(str(error).partition(":")[0], str(error)) from error
    return Response(drawn(trajectory, judgement.outcome), media_type=_PNG) if picture else judgement
