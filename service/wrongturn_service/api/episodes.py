"""Episodes: reset of a practice one, step, and what is shown of them."""

import msgpack
import orjson
from fastapi import APIRouter, Request, Response

from wrongturn_protocol import (
    EpisodeDetail,
    EpisodeReply,
    EpisodeState,
    EvaluationState,
    Outcome,
    PracticeRequest,
    ProblemType,
    StepReply,
    StepRequest,
)
from wrongturn_service import catalogue
from wrongturn_service.accounts import Caller
from wrongturn_service.api.body import parsed
from wrongturn_service.api.dependencies import accepted, caller_of, key_of, repeated, service_of
from wrongturn_service.api.documents import described
from wrongturn_service.encoding import Encoding
from wrongturn_service.errors import ConflictError, ForbiddenError, GoneError
from wrongturn_service.service import Service
from wrongturn_service.storage.models import EpisodeRow

router = APIRouter(prefix="/v1/episodes", tags=["episodes"])


@router.post(
    "",
    **described(EpisodeReply, 404, 429, status=201, body=PracticeRequest, token=True, binary=True, creates=True),
)
async def practise(request: Request) -> Response:
    """Reset: a practice episode, never scored; its replies also carry the reward, and at the end the verdict."""
    service = service_of(request)
    encoding = accepted(request)
    caller = await caller_of(request)
    wanted = await parsed(request, PracticeRequest, binary=True)
    canonical = wanted.model_dump_json().encode()
    async with service.idempotency.once(key_of(request), caller.id, "POST /v1/episodes", canonical) as once:
        if once.stored is not None:
            return repeated(once.stored)
        trial = await catalogue.practice_trial(wanted)
        body = await service.episodes.open_practice(
            caller.id,
            trial,
            wanted.track,
            encoding,
            once.remember(201, encoding),
            once.key,
        )
    return Response(body, 201, media_type=encoding)


@router.post("/{episode}/step", **described(StepReply, 404, 409, 410, 429, body=StepRequest, token=True, binary=True))
async def step(request: Request, episode: str) -> Response:
    """Step: drive on for 0.1 s. The same seq with the same action gives the stored reply."""
    encoding = accepted(request)
    caller = await caller_of(request)
    wanted = await parsed(request, StepRequest, binary=True)
    body = await service_of(request).episodes.step(caller.id, episode, wanted, encoding)
    return Response(body, media_type=encoding)


@router.get("/{episode}", **described(EpisodeDetail, 404, token=True, binary=True))
async def look(request: Request, episode: str) -> Response:
    """The last reply while it is open; the whole once it may be shown, then without a token too."""
    encoding = accepted(request)
    service = service_of(request)
    row, shown = await _seen(request, episode)
    detail = episode_detail(service, row, shown=shown, last_reply=False).model_dump(mode="json")
    last = service.episodes.last_reply(episode, encoding)
    if last is not None:
        detail["seq"] = last[0]
        detail["last_reply"] = msgpack.unpackb(last[1]) if encoding is Encoding.MSGPACK else orjson.loads(last[1])
    body = msgpack.packb(detail) if encoding is Encoding.MSGPACK else orjson.dumps(detail)
    return Response(body, media_type=encoding)


@router.get("/{episode}/trajectory", **described(None, 404, 409, 410, token=True))
async def trajectory(request: Request, episode: str) -> Response:
    """The trajectory's canonical JSON, byte by byte, once it may be shown."""
    row, shown = await _seen(request, episode)
    if row.state == EpisodeState.LOST:
        raise GoneError(f"episode {episode} is lost; it has no trajectory")
    found = await service_of(request).store.trajectory(episode) if shown else None
    if found is None:
        raise ConflictError(
            ProblemType.EPISODE_NOT_SHOWN,
            f"episode {episode} is shown once it, and in an evaluation the whole of it, is finished",
        )
    body, sha256 = found
    return Response(body, media_type=Encoding.JSON, headers={"ETag": f'"{sha256}"'})


@router.delete("/{episode}", **described(None, 404, 409, 410, 429, status=204, token=True))
async def abort(request: Request, episode: str) -> Response:
    """End the episode; a scored one counts as ``aborted``, which is unsafe."""
    caller = await caller_of(request)
    await service_of(request).episodes.abort(caller.id, episode)
    return Response(status_code=204)


async def _seen(request: Request, episode_id: str) -> tuple[EpisodeRow, bool]:
    """An episode's row, and whether its outcome may be shown to who asks."""
    service = service_of(request)
    given = request.headers.get("authorization") is not None
    row = await service.store.episode(episode_id)
    public = row is not None and row.evaluation_id is not None and await is_shown(service, row)
    if row is not None and public and not given:
        return row, True
    caller: Caller = await caller_of(request)
    _, row = await service.episodes.look(caller.id, episode_id)
    if not public and row.agent_id != caller.id:
        raise ForbiddenError(f"episode {episode_id} is another agent's")
    return row, public or await is_shown(service, row)


async def is_shown(service: Service, row: EpisodeRow) -> bool:
    """Whether an episode's trial and outcome may be told: it, and in an evaluation the whole of it, is finished."""
    if row.state != EpisodeState.FINISHED or row.evaluation_id is None:
        return row.state == EpisodeState.FINISHED
    evaluation = await service.store.evaluation(row.evaluation_id)
    return evaluation is not None and evaluation.state == EvaluationState.FINISHED


def episode_detail(service: Service, row: EpisodeRow, *, shown: bool, last_reply: bool = True) -> EpisodeDetail:
    """An episode as it is told.

    Args:
        service: where it may be open.
        row: what is stored of it.
        shown: whether its trial and outcome may be told.
        last_reply: whether the last reply is told while it is open.
    """
    last = service.episodes.last_reply(row.id, Encoding.JSON)
    state = EpisodeState(row.state)
    told = shown and state is EpisodeState.FINISHED
    practice = row.evaluation_id is None
    return EpisodeDetail(
        id=row.id,
        state=state,
        seq=row.steps if last is None else last[0],
        evaluation=row.evaluation_id,
        last_reply=orjson.loads(last[1]) if last is not None and last_reply else None,
        trial=row.trial_id if told or practice else None,
        outcome=Outcome.model_validate_json(row.outcome) if told and row.outcome is not None else None,
        trajectory_sha256=row.trajectory_sha256 if told else None,
        actions_sha256=row.actions_sha256 if told else None,
    )
