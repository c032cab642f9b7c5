"""Episodes: practice, steps, and finished episodes."""

from typing import Annotated, Final

import msgpack
import orjson
from fastapi import APIRouter, Depends, Request, Response

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
    Trial,
)
from wrongturn_protocol.pixmap import PIXMAP
from wrongturn_service import catalogue
from wrongturn_service.api.body import parsed
from wrongturn_service.api.dependencies import (
    AuthorizationDep,
    Body,
    CallerDep,
    DriverDep,
    EncodingDep,
    KeyDep,
    ServiceDep,
    accepted,
    tagged,
)
from wrongturn_service.api.documents import WITHOUT_TOKEN_TOO, Route, described
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.open_episode import check_view, unknown_episode
from wrongturn_service.errors import ConflictError, GoneError
from wrongturn_service.service import Service
from wrongturn_service.storage.models import EpisodeRow

router = APIRouter(prefix="/v1/episodes", tags=["episodes"], route_class=Route)


_LARGEST_STEP: Final = 4096


@router.post("/{episode}/step", **described(StepReply, 404, 409, 410, 429))
async def step(
    service: ServiceDep,
    encoding: EncodingDep,
    caller: DriverDep,
    episode: str,
    wanted: Annotated[StepRequest, Depends(Body(StepRequest, limit=_LARGEST_STEP, binary=True))],
) -> Response:
    """Step: drive on for 0.1 s. The same seq with the same action gets the stored reply."""
    body = await service.episodes.step(caller, episode, wanted, encoding)
    return Response(body, media_type=encoding)


async def plain_step(request: Request, episode: str) -> Response:
    """Call :func:`step` with what it depends on. The middleware does so: FastAPI takes four times as long."""
    service: Service = request.app.state.service
    encoding = await accepted(request)
    caller = await service.accounts.caller(request.headers.get("authorization"))
    wanted = await parsed(request, StepRequest, limit=_LARGEST_STEP, binary=True)
    return await step(service, encoding, caller, episode, wanted)


@router.post("", **described(EpisodeReply, 404, 429, 507, status=201))
async def practise(
    request: Request,
    service: ServiceDep,
    encoding: EncodingDep,
    caller: DriverDep,
    wanted: Annotated[PracticeRequest, Depends(Body(PracticeRequest, limit=16384, binary=True))],
    key: KeyDep,
) -> Response:
    """Reset: begin a practice episode. It is never scored. Replies carry the reward, the last one the verdict."""
    caller.check_practice()
    async with key.once(caller.holder, wanted) as once:
        caller.check_track(wanted)
        trial = await catalogue.practice_trial(wanted, service.draws)
        body = await service.resets.practise(caller, address_of(request), trial, encoding, once)
    return Response(body, 201, media_type=encoding)


@router.get("/{episode}", **described(EpisodeDetail, 404), **WITHOUT_TOKEN_TOO)
async def look(service: ServiceDep, encoding: EncodingDep, authorization: AuthorizationDep, episode: str) -> Response:
    """Show an episode: its last reply while it is open, all of it once the evaluation is finished."""
    row, shown = await _visible(service, authorization, episode)
    detail = episode_detail(service, row, shown=shown, last_reply=False).model_dump(mode="json")
    last = service.episodes.last_reply(episode, encoding)
    if last is not None:
        detail["seq"] = last[0]
        detail["last_reply"] = msgpack.unpackb(last[1]) if encoding is Encoding.MSGPACK else orjson.loads(last[1])
    body = msgpack.packb(detail) if encoding is Encoding.MSGPACK else orjson.dumps(detail)
    return Response(body, media_type=encoding)


@router.get("/{episode}/trajectory", **described(None, 404, 409, 410, tagged=True), **WITHOUT_TOKEN_TOO)
async def trajectory(request: Request, service: ServiceDep, authorization: AuthorizationDep, episode: str) -> Response:
    """Show a finished episode's trajectory as canonical JSON."""
    await _shown(service, authorization, episode)
    found = await service.store.trajectory(episode)
    if found is None:
        raise not_shown(episode)
    body, sha256 = found
    return tagged(request, body, Encoding.JSON, {}, tag=f'"{sha256}"')


@router.get(
    "/{episode}/camera/{sheet}",
    **described(None, 404, 409, 410, 422, media="image/webp", tagged=True),
    **WITHOUT_TOKEN_TOO,
)
async def camera(
    request: Request, service: ServiceDep, authorization: AuthorizationDep, episode: str, sheet: int
) -> Response:
    """Show what the camera saw at 20 decisions of a finished episode, one picture below the other.

    Sheet 0 begins with the reset. The service draws the pictures from the trajectory, on any track; WebP rounds them.
    """
    await _shown(service, authorization, episode)
    body = await service.replays.sheet(episode, sheet)
    return tagged(request, body, "image/webp", _for_good(authorization))


@router.get("/{episode}/view", **described(None, 404, 409, 410, 429, media=PIXMAP))
async def view(service: ServiceDep, caller: CallerDep, episode: str) -> Response:
    """Show a practice episode's moment: the town from above beside the camera's picture, on any track.

    The last moment stays after the end. Episodes of evaluations have no view, because it shows the route.
    """
    body = await service.episodes.view(caller, episode)
    if body is None:
        row = await service.episodes.look(caller, episode)
        caller.check_episode(row)
        check_view(episode, row.evaluation_id)
        if row.state == EpisodeState.LOST:
            raise GoneError(f"episode {episode} is lost; begin another one")
        outcome = None if row.outcome is None else Outcome.model_validate_json(row.outcome)
        body = await service.replays.last_view(episode, outcome)
    return Response(body, media_type=PIXMAP)


@router.get(
    "/{episode}/picture.png", **described(None, 404, 409, 410, media="image/png", tagged=True), **WITHOUT_TOKEN_TOO
)
async def picture(request: Request, service: ServiceDep, authorization: AuthorizationDep, episode: str) -> Response:
    """Show a finished episode from above: the car's way, coloured by speed, its footprints, and the verdict."""
    row = await _shown(service, authorization, episode)
    outcome = Outcome.model_validate_json(row.outcome) if row.outcome is not None else None
    body = await service.replays.picture(episode, outcome)
    return tagged(request, body, "image/png", _for_good(authorization))


@router.delete("/{episode}", **described(None, 404, 409, 410, 429, status=204))
async def abort(service: ServiceDep, caller: DriverDep, episode: str) -> Response:
    """End the episode. A scored one counts as ``aborted``, which is unsafe."""
    await service.episodes.abort(caller, episode)
    return Response(status_code=204)


async def _visible(service: Service, authorization: str | None, episode_id: str) -> tuple[EpisodeRow, bool]:
    """Return an episode's row, and whether the caller may see its outcome."""
    row = await service.store.episode(episode_id)
    # A fork is shown with the episode that it comes from.
    forked = row is not None and row.origin_id is not None and row.state == EpisodeState.FINISHED
    of = await service.store.episode(row.origin_id or "") if row is not None and forked else row
    scored = of is not None and of.evaluation_id is not None and await is_shown(service, of)
    public = of is not None and scored and await service.store.is_public(of.evaluation_id or "")
    if row is not None and public and authorization is None:
        return row, True
    if row is not None and scored and not public:  # the operator hides it
        if not await service.accounts.owns(authorization, row.agent_id):
            raise unknown_episode(episode_id)
        return row, True
    caller = await service.accounts.caller(authorization)
    row = await service.episodes.look(caller, episode_id)
    if not public:
        caller.check_episode(row)
    return row, public or await is_shown(service, row)


async def _shown(service: Service, authorization: str | None, episode: str) -> EpisodeRow:
    """Return the row of an episode whose trajectory the caller may see. Raises GoneError, ConflictError."""
    row, shown = await _visible(service, authorization, episode)
    if row.state == EpisodeState.LOST:
        raise GoneError(f"episode {episode} is lost; it has no trajectory")
    if not shown:
        raise not_shown(episode)
    return row


def not_shown(episode: str) -> ConflictError:
    """Return the error for an episode whose trial and outcome are not public yet."""
    return ConflictError(
        ProblemType.EPISODE_NOT_SHOWN, f"episode {episode} is shown once it and its whole evaluation are finished"
    )


def _for_good(authorization: str | None) -> dict[str, str]:
    """Return the headers of a picture that never changes."""
    whose = "public" if authorization is None else "private"
    return {"Cache-Control": f"{whose}, max-age=604800, immutable"}


async def is_shown(service: Service, row: EpisodeRow) -> bool:
    """Return whether an episode's trial and outcome are public: it and its whole evaluation are finished."""
    if row.state != EpisodeState.FINISHED or row.evaluation_id is None:
        return row.state == EpisodeState.FINISHED
    evaluation = await service.store.evaluation(row.evaluation_id)
    return evaluation is not None and evaluation.state == EvaluationState.FINISHED


def episode_detail(service: Service, row: EpisodeRow, *, shown: bool, last_reply: bool = True) -> EpisodeDetail:
    """Return an episode's details: trial and outcome if they are ``shown``, and an open one's last reply."""
    last = service.episodes.last_reply(row.id, Encoding.JSON)
    state = EpisodeState(row.state)
    public = shown and state is EpisodeState.FINISHED
    practice = row.evaluation_id is None
    return EpisodeDetail(
        id=row.id,
        state=state,
        seq=row.steps if last is None else last[0],
        evaluation=row.evaluation_id,
        origin=row.origin_id,
        last_reply=orjson.loads(last[1]) if last is not None and last_reply else None,
        trial=row.trial_id if public or practice else None,
        trial_detail=Trial.model_validate_json(row.trial) if public or practice else None,
        outcome=Outcome.model_validate_json(row.outcome) if public and row.outcome is not None else None,
        trajectory_sha256=row.trajectory_sha256 if public else None,
        actions_sha256=row.actions_sha256 if public else None,
    )
