"""Evaluations: one agent on one suite, trial by trial."""

from typing import Annotated, Final

from fastapi import APIRouter, Depends, Request, Response

from wrongturn_networks import commitment_of
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
from wrongturn_protocol.certificates import Certificate
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service import catalogue
from wrongturn_service.accounts import Caller
from wrongturn_service.api.dependencies import (
    AuthorizationDep,
    Body,
    CallerDep,
    DriverDep,
    EncodingDep,
    KeyDep,
    ServiceDep,
    driven_by,
    owned_by,
    reply,
)
from wrongturn_service.api.documents import WITHOUT_TOKEN_TOO, Route, described
from wrongturn_service.api.episodes import episode_detail
from wrongturn_service.api.paging import PageDep
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.evaluations import new_evaluation
from wrongturn_service.errors import ConflictError, InvalidRequestError, NotFoundError, unknown
from wrongturn_service.idempotency import HEADER, IdempotentRequest, StoredReplyError
from wrongturn_service.service import Service
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow, IdempotencyRow

_RESULTS: Final = 16384
"""Bytes of results without their episodes."""
_RECORD: Final = 512
"""Bytes of results for each trial."""
router = APIRouter(prefix="/v1/evaluations", tags=["evaluations"], route_class=Route)


@router.post("", **described(EvaluationDetail, 404, 409, 507, status=201))
async def begin(
    service: ServiceDep,
    caller: CallerDep,
    wanted: Annotated[EvaluationRequest, Depends(Body(EvaluationRequest, limit=4096))],
    key: KeyDep,
) -> Response:
    """Begin an evaluation of the token's agent. What is begun counts, from its first step on."""
    try:
        async with key.once(caller.id, wanted) as once:
            return reply(_detail(await _begin(service, caller, wanted, once), 0, service), 201)
    except StoredReplyError as answered:
        before = EvaluationDetail.model_validate_json(answered.stored.body).id
        if await service.store.evaluation(before) is None:
            raise NotFoundError(
                ProblemType.UNKNOWN_EVALUATION,
                f"evaluation {before}, which this {HEADER} began, was deleted before its first step; "
                f"send a new {HEADER} to begin another",
            ) from None
        raise


async def _begin(service: Service, caller: Caller, wanted: EvaluationRequest, once: IdempotentRequest) -> EvaluationRow:
    suite = catalogue.suite(wanted.suite)
    row = new_evaluation(suite, caller.id, caller.track, caller.rig, Entry.REMOTE)

    def remember(begun: EvaluationRow) -> IdempotencyRow | None:
        return once.row(_detail(begun, 0, service).model_dump_json().encode(), 201, Encoding.JSON)

    begun = await service.store.begin_evaluation(row, remember)
    service.draws.prepare(suite, begun.secret)
    if begun is not row:
        raise _open(begun)
    return begun


def _open(row: EvaluationRow) -> ConflictError:
    remedy = f"go on with it by POST /v1/evaluations/{row.id}/episodes, or close it by DELETE /v1/evaluations/{row.id}"
    if row.entry == Entry.UPLOADED:
        remedy = "the service drives it, as it was handed in; to stop it, cancel its submission"
    return ConflictError(
        ProblemType.EVALUATION_OPEN,
        f"this agent's evaluation {row.id} on {row.suite} is not finished; {remedy}",
        errors=[FieldError(path="evaluation", message=row.id)],
    )


@router.get("/{evaluation}", **described(EvaluationDetail, 404), **WITHOUT_TOKEN_TOO)
async def evaluation(service: ServiceDep, authorization: AuthorizationDep, evaluation: str) -> Response:
    """Show an evaluation: its state and progress, then its secret and metrics. A finished one is public."""
    return reply(await _current(service, await _visible(service, authorization, evaluation)))


@router.get("/{evaluation}/certificate", **described(Certificate, 404, 409), **WITHOUT_TOKEN_TOO)
async def certificate(service: ServiceDep, authorization: AuthorizationDep, evaluation: str) -> Response:
    """Show the signed record of a finished evaluation. ``wrongturn verify`` checks it. It is public once finished."""
    row = await _visible(service, authorization, evaluation)
    key = ("certificate", row.id, row.state, service.certificates.public)
    return Response(await service.cache.get(key, lambda: service.certificates.of(row)), media_type=Encoding.JSON)


@router.delete("/{evaluation}", **described(EvaluationDetail, 404))
async def close(service: ServiceDep, caller: CallerDep, evaluation: str) -> Response:
    """Close the evaluation for good. Before its first step it disappears, and the next one has the same trials.

    After that it counts: it is finished, and every trial without a verdict is ``aborted``, which is unsafe.
    """
    row = await driven_by(service, caller, evaluation)
    await service.closings.close(evaluation)
    newest = await service.store.evaluation(evaluation)
    if newest is None:
        gone = _detail(row, 0, service)
        return reply(gone.model_copy(update={"state": EvaluationState.CANCELLED}))
    return reply(await _current(service, newest))


@router.post("/{evaluation}/episodes", **described(EpisodeReply, 404, 409, 429, status=201))
async def reset(
    request: Request, service: ServiceDep, encoding: EncodingDep, caller: DriverDep, evaluation: str, key: KeyDep
) -> Response:
    """Reset: begin the next trial's episode. You learn which trial it was once the evaluation is finished."""
    with service.resets.in_progress.one(evaluation):
        row = await driven_by(service, caller, evaluation)  # before a stored reply, whose evaluation may be deleted
        async with key.once(caller.holder) as once:
            body = await service.resets.next(caller, address_of(request), row, encoding, once)
    return Response(body, 201, media_type=encoding)


@router.get("/{evaluation}/episodes", **described(EpisodeList, 404, 422), **WITHOUT_TOKEN_TOO)
async def episodes(
    service: ServiceDep,
    authorization: AuthorizationDep,
    evaluation: str,
    page: PageDep,
    state: EpisodeState | None = None,
) -> Response:
    """List the evaluation's episodes. After a crash, ``state=open`` tells which you can go on with.

    Those of a finished evaluation are public.
    """
    row = await _visible(service, authorization, evaluation)
    if state is EpisodeState.OPEN:
        await service.resets.in_progress.over(evaluation)
    rows = await service.store.episodes(evaluation, state, after=page.number, limit=page.limit + 1)
    rows, following = page.cut(rows, lambda found: found.seq)
    shown = row.state == EvaluationState.FINISHED
    details = tuple(episode_detail(service, found, shown=shown) for found in rows)
    return reply(EpisodeList(episodes=details, next=following))


async def _results_limit(request: Request) -> int:
    """Return the most bytes of the results of a request's evaluation: about three times what the client sends."""
    service: Service = request.app.state.service
    row = await service.store.evaluation(request.path_params["evaluation"])
    return _RESULTS + (0 if row is None else row.trials * _RECORD)


@router.put("/{evaluation}/results", **described(EvaluationDetail, 404, 409, 507))
async def results(
    service: ServiceDep,
    caller: DriverDep,
    evaluation: str,
    record: Annotated[ResultsRequest, Depends(Body(ResultsRequest, limit=_results_limit))],
) -> Response:
    """Take the worker's own record. It has to agree with what the service saw."""
    _check_once(record)
    row = await driven_by(service, caller, evaluation)
    seen = {found.id: found for found in await service.store.episodes(evaluation, EpisodeState.FINISHED)}
    wrong = [error for index in range(len(record.episodes)) for error in _differences(record, index, seen)]
    if wrong:
        raise ConflictError(
            ProblemType.RESULTS_MISMATCH,
            f"{wrong[0].path}: {wrong[0].message}" + (f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""),
            errors=wrong[:50],
        )
    await service.store.put_results(evaluation, record.model_dump_json())
    return reply(await _current(service, row))


def _check_once(record: ResultsRequest) -> None:
    """Raise InvalidRequestError if the record names an episode twice."""
    first: dict[str, int] = {}
    for index, told in enumerate(record.episodes):
        before = first.setdefault(told.episode, index)
        if before != index:
            raise InvalidRequestError(
                f"episodes.{index}.episode", f"is the same as episodes.{before}; name each episode once"
            )


def _differences(record: ResultsRequest, index: int, seen: dict[str, EpisodeRow]) -> list[FieldError]:
    told = record.episodes[index]
    row = seen.get(told.episode)
    path = f"episodes.{index}"
    if row is None:
        return [FieldError(path=f"{path}.episode", message="is not a finished episode of this evaluation")]
    if not row.steps:
        return [FieldError(path=f"{path}.episode", message="was not driven: it ended before its first step")]
    errors = []
    if told.steps != row.steps:
        errors.append(FieldError(path=f"{path}.steps", message=f"is {told.steps}, the service saw {row.steps}"))
    # An episode that ended without a simulator has no hash.
    if row.actions_sha256 is not None and told.actions_sha256 != row.actions_sha256:
        errors.append(FieldError(path=f"{path}.actions_sha256", message="differs from what the service saw"))
    return errors


async def _visible(service: Service, authorization: str | None, evaluation_id: str) -> EvaluationRow:
    """Return an evaluation to its agent, and a finished one to everybody unless the operator hides it."""
    row = await service.store.evaluation(evaluation_id)
    if row is None or row.state != EvaluationState.FINISHED:
        return await owned_by(service, await service.accounts.caller(authorization), evaluation_id)
    if not await service.store.is_public(row.id) and not await service.accounts.owns(authorization, row.agent_id):
        raise unknown(Collection.EVALUATIONS, evaluation_id)
    return row


async def _current(service: Service, row: EvaluationRow) -> EvaluationDetail:
    return _detail(row, await service.store.finished_count(row.id), service)


def _detail(row: EvaluationRow, count: int, service: Service) -> EvaluationDetail:
    drawn = bool(catalogue.suite(row.suite).cells)
    over = row.state == EvaluationState.FINISHED
    return EvaluationDetail(
        id=row.id,
        suite=row.suite,
        agent=row.agent_id,
        state=EvaluationState(row.state),
        trials=row.trials,
        finished=count,
        max_parallel=service.settings.max_parallel,
        commitment=commitment_of(row.secret) if drawn else None,
        secret=row.secret if drawn and over else None,
        metrics=None if row.metrics is None else Metrics.model_validate_json(row.metrics),
    )
