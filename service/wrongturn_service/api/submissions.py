"""Submissions: agents that are handed in as a model."""

import json
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.resources import files
from typing import Any, Final

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, TypeAdapter, ValidationError

from wrongturn_networks import Suite
from wrongturn_protocol import (
    SubmissionDetail,
    SubmissionList,
    SubmissionLog,
    SubmissionLogLine,
    SubmissionState,
    Track,
)
from wrongturn_protocol.accounts import NAME_RULE, AgentName
from wrongturn_protocol.submissions import NAME, SUITE
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service import catalogue
from wrongturn_service.accounts import Submitter
from wrongturn_service.api.body import check_uncompressed
from wrongturn_service.api.dependencies import AuthorizationDep, KeyDep, RequestKey, ServiceDep, reply
from wrongturn_service.api.documents import Route, described
from wrongturn_service.api.errors import as_service_error
from wrongturn_service.api.paging import PageDep
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.episodes.evaluations import check_takes
from wrongturn_service.errors import ForbiddenError, InvalidRequestError, unknown
from wrongturn_service.idempotency import StoredReplyError
from wrongturn_service.service import Service
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.submissions.upload import Upload
from wrongturn_service.tokens import new_id

router = APIRouter(prefix="/v1/submissions", tags=["submissions"], route_class=Route)
_NAME: Final[TypeAdapter[str]] = TypeAdapter(AgentName)
_WAITING: Final = {SubmissionState.QUEUED, SubmissionState.CHECKED}
_FORM: Final[dict[str, Any]] = json.loads((files("wrongturn_service.api") / "form.json").read_text("utf-8"))
"""The fields of the form, for the OpenAPI document."""


class _Request(BaseModel):
    """What an idempotency key stands for."""

    suite: str
    name: str
    sha256: str


@router.post(
    "", **described(SubmissionDetail, 400, 404, 408, 409, 413, 415, 422, 429, 507, status=202), openapi_extra=_FORM
)
async def hand_in(request: Request, service: ServiceDep, authorization: AuthorizationDep, key: KeyDep) -> Response:
    """Hand an agent in as an ONNX file. The service checks it within seconds, and drives it when it is its turn.

    With an owner's token the agent is new, and the service makes it once the model is checked. The same file by the
    same name and owner is the same agent on another suite. With an agent's token the agent is that one, if it has not
    begun the suite. Follow the submission with GET until its state is ``finished``, ``failed`` or ``cancelled``.

    Token, size and type are checked before the body is read, so a client that sends ``Expect: 100-continue`` never
    sends a model in vain; name and suite with the model's first bytes, if they come before it.
    """
    arrived = False
    try:
        await service.availability.check()
        submitter = await service.accounts.submitter(authorization)
        if submitter.owner is None:
            raise ForbiddenError("the operator's token hands nothing in; send an owner's, or an agent's")
        headers = request.headers
        said = headers.get("content-length", "")
        length = int(said[:20]) if said.isdecimal() else None
        check_uncompressed(headers.getlist("content-encoding"))
        boundary = service.uploads.boundary(length, headers.get("content-type", ""))
        if key.value is None:
            # A repeat has to get its stored reply, even if there is no more room.
            await service.submissions.check_room(submitter.owner.id)
            await service.store.check_room(submitter.owner.id, length or 0)
        await service.uploads.check_disk(length)
        submission = new_id("su")
        with service.uploads.one(submitter.owner.id, address_of(request)):
            look = partial(_look, service, submitter)
            async with service.uploads.receive(submission, boundary, request.stream(), look) as upload:
                arrived = True
                return await _take(service, submitter, key, submission, upload)
    except StoredReplyError:
        raise
    except Exception as error:
        refused = as_service_error(error)
        if not arrived:
            # The rest of the body is not read, so the connection cannot be used again.
            refused.headers["Connection"] = "close"
        raise refused from error


async def _look(service: Service, submitter: Submitter, fields: dict[str, str]) -> None:
    """Check the fields that came before the model. Raises NotFoundError, ConflictError, InvalidRequestError."""
    if SUITE in fields:
        check_takes(catalogue.suite(fields[SUITE]), _track(submitter))
    if NAME in fields:
        name = _name(service, submitter, fields)
        if submitter.agent is None and submitter.owner is not None:
            await service.submissions.check_name(submitter.owner.id, name)


def _track(submitter: Submitter) -> Track | None:
    return None if submitter.agent is None else Track(submitter.agent.track)


async def _take(service: Service, submitter: Submitter, key: RequestKey, submission: str, upload: Upload) -> Response:
    suite, name = upload.fields[SUITE], _name(service, submitter, upload.fields)
    async with key.once(submitter.id, _Request(suite=suite, name=name, sha256=upload.sha256)) as once:
        row = _row(submitter, catalogue.suite(suite), submission, name, upload)
        positions = await service.dispatcher.positions()
        body = _detail(row, {**positions, row.id: len(positions)}, {}).model_dump_json().encode()
        await upload.keep()
        await service.submissions.add(row, once.row(body, 202, Encoding.JSON))
    return Response(body, 202, media_type=Encoding.JSON)


def _name(service: Service, submitter: Submitter, fields: dict[str, str]) -> str:
    """Return the name of the agent. Raises InvalidRequestError, ConflictError."""
    name = fields.get(NAME)
    if submitter.agent is not None:
        if name not in {None, submitter.agent.name}:
            raise InvalidRequestError(
                NAME,
                f"the token is agent {submitter.agent.name!r}'s, so leave the name out; to hand in a new agent, "
                "send its owner's token",
            )
        return submitter.agent.name
    if name is None:
        raise InvalidRequestError(NAME, "is missing; name the new agent")
    try:
        valid = _NAME.validate_python(name)
    except ValidationError:
        raise InvalidRequestError(NAME, NAME_RULE) from None
    service.registrations.check_agent_name(valid)
    return valid


def _row(submitter: Submitter, suite: Suite, submission: str, name: str, upload: Upload) -> SubmissionRow:
    """Return the row of a submission. Raises ConflictError, InvalidRequestError if the suite does not take it."""
    owner, agent = submitter.owner, submitter.agent
    assert owner is not None
    check_takes(suite, _track(submitter))
    return SubmissionRow(
        id=submission,
        owner_id=owner.id,
        owner=owner,
        agent_id=None if agent is None else agent.id,
        agent_made=agent is None,
        suite=suite.id,
        name=name,
        name_key=name.lower(),
        track=None if agent is None else agent.track,
        sha256=upload.sha256,
        size=upload.size,
        state=SubmissionState.QUEUED.value,
        created=time.time(),
    )


@router.get("", **described(SubmissionList, 422))
async def submissions(service: ServiceDep, authorization: AuthorizationDep, page: PageDep) -> Response:
    """List submissions, newest first: an owner's, an agent's, or all for the operator."""
    submitter = await service.accounts.submitter(authorization)
    agent = None if submitter.agent is None else submitter.agent.id
    owner = None if submitter.owner is None or agent is not None else submitter.owner.id
    newest = partial(
        service.submissions.rows.newest, owner=owner, agent=agent, before=page.number, limit=page.limit + 1
    )
    await service.submissions.settled([row.id for row in await newest()])
    found, following = page.cut(await newest(), lambda row: row.seq)
    return reply(SubmissionList(submissions=await _details(service, found), next=following))


@router.get("/{submission}", **described(SubmissionDetail, 404))
async def submission(service: ServiceDep, authorization: AuthorizationDep, submission: str) -> Response:
    """Show a submission: its state, its place in the line, its progress, and why it failed."""
    row = await _seen(service, await service.accounts.submitter(authorization), submission)
    return reply((await _details(service, [row]))[0])


@router.get("/{submission}/log", **described(SubmissionLog, 404))
async def log(service: ServiceDep, authorization: AuthorizationDep, submission: str) -> Response:
    """Show what happened to a submission so far, oldest first. The log is deleted some time after its end."""
    row = await _seen(service, await service.accounts.submitter(authorization), submission)
    lines = await service.submissions.rows.log(row.id)
    return reply(SubmissionLog(lines=tuple(SubmissionLogLine(time=_iso(at.time), message=at.message) for at in lines)))


@router.delete("/{submission}", **described(SubmissionDetail, 404))
async def cancel(request: Request, service: ServiceDep, authorization: AuthorizationDep, submission: str) -> Response:
    """Cancel a submission. One that is over stays as it is.

    Before it runs, nothing remains but its record, and its name is free again. While it runs, its evaluation is closed:
    before the first step it disappears, later its missing trials count as ``aborted``.
    """
    submitter = await service.accounts.submitter(authorization)
    row = await _seen(service, submitter, submission)
    by = "the operator" if submitter.owner is None else "its owner" if submitter.agent is None else "its agent"
    if await service.submissions.end(row.id, SubmissionState.CANCELLED, f"cancelled by {by}, as asked"):
        await service.administration.note(request, AuditAction.CANCEL, Collection.SUBMISSIONS, row)
    return reply((await _details(service, [await _known(service, row.id)]))[0])


async def _known(service: Service, submission: str) -> SubmissionRow:
    await service.submissions.settled([submission])
    row = await service.submissions.rows.get(submission)
    if row is None:
        raise unknown(Collection.SUBMISSIONS, submission)
    return row


async def _seen(service: Service, submitter: Submitter, submission: str) -> SubmissionRow:
    """Return a submission that the caller may see. Raises ForbiddenError, NotFoundError."""
    row = await _known(service, submission)
    submitter.check_sees(row)
    return row


async def _details(service: Service, rows: Sequence[SubmissionRow]) -> tuple[SubmissionDetail, ...]:
    waits = any(SubmissionState(row.state) in _WAITING for row in rows)
    positions = await service.dispatcher.positions() if waits else {}
    progress = await service.submissions.rows.progress({row.evaluation_id for row in rows if row.evaluation_id})
    return tuple(_detail(row, positions, progress) for row in rows)


def _detail(row: SubmissionRow, positions: dict[str, int], progress: dict[str, tuple[int, int]]) -> SubmissionDetail:
    finished, episodes = progress.get(row.evaluation_id or "", (None, None))
    return SubmissionDetail(
        id=row.id,
        state=SubmissionState(row.state),
        suite=row.suite,
        name=row.name,
        owner=row.owner.name,
        sha256=row.sha256,
        size=row.size,
        created=_iso(row.created),
        position=positions.get(row.id),
        track=None if row.track is None else Track(row.track),
        agent=row.agent_id,
        evaluation=row.evaluation_id,
        finished=finished,
        episodes=episodes,
        reason=row.reason,
    )


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
