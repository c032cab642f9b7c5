"""Evaluations: one agent on one suite, trial by trial."""

import secrets
import time

from fastapi import APIRouter, Request, Response

from wrongturn_protocol import (
    Entry,
    EpisodeList,
    EpisodeReply,
    EpisodeState,
    EvaluationDetail,
    EvaluationRequest,
    EvaluationState,
    FieldError,
    Metrics,
    ProblemType,
    ResultsRequest,
)
from wrongturn_service import catalogue
from wrongturn_service.api.body import parsed
from wrongturn_service.api.dependencies import (
    accepted,
    caller_of,
    key_of,
    owned_evaluation,
    repeated,
    reply,
    service_of,
)
from wrongturn_service.api.documents import described
from wrongturn_service.api.episodes import episode_detail
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.evaluations import finished
from wrongturn_service.errors import ConflictError, InvalidRequestError
from wrongturn_service.service import Service
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow
from wrongturn_service.tokens import new_id

router = APIRouter(prefix="/v1/evaluations", tags=["evaluations"])


@router.post("", **described(EvaluationDetail, 404, 429, status=201, body=EvaluationRequest, token=True, creates=True))
async def begin(request: Request) -> Response:
    """Begin an evaluation of the token's agent."""
    service = service_of(request)
    caller = await caller_of(request)
    wanted = await parsed(request, EvaluationRequest)
    canonical = wanted.model_dump_json().encode()
    async with service.idempotency.once(key_of(request), caller.id, "POST /v1/evaluations", canonical) as once:
        if once.stored is not None:
            return repeated(once.stored)
        suite = catalogue.suite(wanted.suite)
        if caller.track not in suite.tracks:
            tracks = ", ".join(suite.tracks)
            raise InvalidRequestError(
                "suite",
                f"{suite.id} is of the tracks {tracks}, the agent of {caller.track}",
                ProblemType.TRACK_NOT_AVAILABLE,
            )
        row = EvaluationRow(
            id=new_id("ev"),
            agent_id=caller.id,
            suite=suite.id,
            suite_sha256=suite.sha256,
            entry=Entry.REMOTE.value,
            state=EvaluationState.RUNNING.value,
            secret=secrets.token_hex(32),
            trials=len(suite.episodes),
            created=time.time(),
        )
        detail = _detail(row, 0, service)
        remember = once.remember(201, Encoding.JSON)
        stored = remember(detail.model_dump_json().encode()) if remember else None
        await service.accounts.begin_evaluation(row, stored)
    return reply(detail, 201)


@router.get("/{evaluation}", **described(EvaluationDetail, 404, token=True))
async def evaluation(request: Request, evaluation: str) -> Response:
    """State and progress, and the metrics when finished."""
    row = await owned_evaluation(request, await caller_of(request), evaluation)
    return reply(await _current(request, row))


@router.delete("/{evaluation}", **described(EvaluationDetail, 404, 409, token=True))
async def cancel(request: Request, evaluation: str) -> Response:
    """Cancel the evaluation for good; its open episodes end without a verdict."""
    service = service_of(request)
    caller = await caller_of(request)
    row = await owned_evaluation(request, caller, evaluation)
    if row.state == EvaluationState.FINISHED:
        raise finished(evaluation)
    await service.episodes.cancel(evaluation)
    service.leaderboards.forget(row.suite)
    return reply(await _current(request, await owned_evaluation(request, caller, evaluation)))


@router.post(
    "/{evaluation}/episodes",
    **described(EpisodeReply, 404, 409, 429, status=201, token=True, binary=True, creates=True),
)
async def reset(request: Request, evaluation: str) -> Response:
    """Reset: the next trial's episode. Which trial it is, is told when the evaluation is finished."""
    service = service_of(request)
    encoding = accepted(request)
    caller = await caller_of(request)
    call = f"POST /v1/evaluations/{evaluation}/episodes"
    with service.episodes.beginnings.one(evaluation):
        async with service.idempotency.once(key_of(request), caller.id, call, b"") as once:
            if once.stored is not None:
                return repeated(once.stored)
            row = await owned_evaluation(request, caller, evaluation)
            body = await service.episodes.open_next(row, caller.track, encoding, once.remember(201, encoding), once.key)
    return Response(body, 201, media_type=encoding)


@router.get("/{evaluation}/episodes", **described(EpisodeList, 404, 422, token=True))
async def episodes(request: Request, evaluation: str, state: EpisodeState | None = None) -> Response:
    """The evaluation's episodes; ``state=open`` to find one's way back after a crash."""
    service = service_of(request)
    row = await owned_evaluation(request, await caller_of(request), evaluation)
    if state is EpisodeState.OPEN:
        await service.episodes.beginnings.over(evaluation)
    rows = await service.store.episodes(evaluation, state)
    shown = row.state == EvaluationState.FINISHED
    return reply(EpisodeList(episodes=tuple(episode_detail(service, found, shown=shown) for found in rows)))


@router.put("/{evaluation}/results", **described(EvaluationDetail, 404, 409, body=ResultsRequest, token=True))
async def results(request: Request, evaluation: str) -> Response:
    """The worker's own record; it has to agree with what the service saw."""
    service = service_of(request)
    caller = await caller_of(request)
    record = await parsed(request, ResultsRequest)
    _check_once(record)
    row = await owned_evaluation(request, caller, evaluation)
    seen = {found.id: found for found in await service.store.episodes(evaluation, EpisodeState.FINISHED)}
    wrong = [error for index in range(len(record.episodes)) for error in _differences(record, index, seen)]
    if wrong:
        raise ConflictError(
            ProblemType.RESULTS_MISMATCH,
            f"{wrong[0].path}: {wrong[0].message}" + (f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""),
            errors=wrong[:50],
        )
    await service.store.put_results(evaluation, record.model_dump_json())
    return reply(await _current(request, row))


def _check_once(record: ResultsRequest) -> None:
    """Raise InvalidRequestError where an episode stands in the record twice."""
    first: dict[str, int] = {}
    for index, told in enumerate(record.episodes):
        before = first.setdefault(told.episode, index)
        if before != index:
            raise InvalidRequestError(
                f"episodes.{index}.episode",
                f"stands in the record already, as episodes.{before}; name each episode once",
            )


def _differences(record: ResultsRequest, index: int, seen: dict[str, EpisodeRow]) -> list[FieldError]:
    told = record.episodes[index]
    row = seen.get(told.episode)
    path = f"episodes.{index}"
    if row is None:
        return [FieldError(path=f"{path}.episode", message="is no finished episode of this evaluation")]
    errors = []
    if told.steps != row.steps:
        errors.append(FieldError(path=f"{path}.steps", message=f"is {told.steps}, the service saw {row.steps}"))
    # An episode that ended without any simulator has no hash: nothing to compare.
    if row.actions_sha256 is not None and told.actions_sha256 != row.actions_sha256:
        errors.append(FieldError(path=f"{path}.actions_sha256", message="differs from what the service saw"))
    return errors


async def _current(request: Request, row: EvaluationRow) -> EvaluationDetail:
    service = service_of(request)
    return _detail(row, await service.store.finished_count(row.id), service)


def _detail(row: EvaluationRow, count: int, service: Service) -> EvaluationDetail:
    return EvaluationDetail(
        id=row.id,
        suite=row.suite,
        agent=row.agent_id,
        state=EvaluationState(row.state),
        trials=row.trials,
        finished=count,
        max_parallel=service.settings.parallel,
        metrics=None if row.metrics is None else Metrics.model_validate_json(row.metrics),
    )
