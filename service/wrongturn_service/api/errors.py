"""The handler of all errors: each becomes ``application/problem+json`` with a type from the closed list."""

import asyncio

import structlog
from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.api.dependencies import StoredReplyError, reply, stored_reply
from wrongturn_service.api.documents import described, methods_at
from wrongturn_service.errors import InvalidRequestError, ServiceError, UnauthenticatedError, UnavailableError, title
from wrongturn_service.simulators.interface import EpisodeRefusedError, SimulatorsBusyError, SimulatorStartError
from wrongturn_service.storage.accounts import HolderGoneError
from wrongturn_service.web.errors import error_page, page_without_slash, wants_page

MEDIA_TYPE = "application/problem+json"
_log = structlog.get_logger("errors")
_EXPLANATIONS = {
    ProblemType.MALFORMED_BODY: (
        "The body is not JSON, or not msgpack or a form although its Content-Type says so. A form may also lack its "
        "boundary, or end too early."
    ),
    ProblemType.VALIDATION: "A field is missing, unknown, of a wrong type or out of range. `errors` names each.",
    ProblemType.UNAUTHENTICATED: "The call needs a bearer token. It had none, or one that nobody has.",
    ProblemType.FORBIDDEN: "The token is valid, but the call is for another agent or the operator.",
    ProblemType.UNKNOWN_ROUTE: "There is no such call. See /openapi.json.",
    ProblemType.METHOD_NOT_ALLOWED: "The path does not take this method. Allow names those that it takes.",
    ProblemType.NOT_ACCEPTABLE: "Accept names neither application/json nor application/msgpack.",
    ProblemType.UNSUPPORTED_MEDIA_TYPE: "The call does not take this Content-Type, or no compressed body.",
    ProblemType.BODY_TOO_LARGE: "The body is too large. Each call has a limit of its own.",
    ProblemType.HEAD_TOO_LARGE: (
        "The request's address, one of its headers or all of them, or the framing of its body are too large."
    ),
    ProblemType.REQUEST_TIMEOUT: "The request, or a message of /v1/drive, did not arrive completely in time.",
    ProblemType.PROTOCOL_VERSION: "The handshake of /v1/drive names no version that this service speaks.",
    ProblemType.TEXT_MESSAGE: "A message of /v1/drive was text. Messages are binary.",
    ProblemType.MESSAGE_TOO_LARGE: "A message of /v1/drive is too large.",
    ProblemType.TRUNCATED_MESSAGE: "A message of /v1/drive ends before it is complete.",
    ProblemType.MALFORMED_MESSAGE: "A message of /v1/drive is not msgpack, or not of its protocol.",
    ProblemType.UNKNOWN_SUITE: "There is no suite with this id. GET /v1/suites lists them.",
    ProblemType.UNKNOWN_TOWN: "There is no town with this name. GET /v1/towns lists them.",
    ProblemType.UNKNOWN_APPROACH: "The town has no such approach. GET /v1/towns/{town} lists them.",
    ProblemType.UNKNOWN_TRIAL: "The suite has no such trial. GET /v1/suites/{suite}/trials lists them.",
    ProblemType.UNKNOWN_OWNER: "There is no owner with this id. GET /v1/owners lists them.",
    ProblemType.UNKNOWN_AGENT: "There is no agent with this id.",
    ProblemType.UNKNOWN_EVALUATION: "There is no evaluation with this id.",
    ProblemType.UNKNOWN_EPISODE: "There is no episode with this id.",
    ProblemType.UNKNOWN_SUBMISSION: "There is no submission with this id.",
    ProblemType.FAULT_NOT_APPLICABLE: "The fault is not built yet, or this approach does not allow it.",
    ProblemType.TRACK_NOT_AVAILABLE: (
        "The suite does not take agents of this track, or practice was asked for in another track than the agent's own."
    ),
    ProblemType.AGENT_NAME_TAKEN: "Another agent has this name. Upper and lower case are the same.",
    ProblemType.OWNER_NAME_TAKEN: "Another owner has this name. Upper and lower case are the same.",
    ProblemType.REGISTRATION_CLOSED: "Only the operator registers owners here. An owner registers agents by its token.",
    ProblemType.RATE_LIMITED: (
        "You have reached a limit. Come back after Retry-After seconds. `position` says how many of your own have to "
        "end first."
    ),
    ProblemType.QUOTA_REACHED: (
        "You, or the address that registered you, have as much stored here as may be. Waiting does not help: `detail` "
        "says what does."
    ),
    ProblemType.IDEMPOTENCY_KEY_REUSED: "The Idempotency-Key was already sent with another request.",
    ProblemType.EVALUATION_OPEN: (
        "The agent has an evaluation on this suite that is not finished. Go on with it, or DELETE it: before its first "
        "step it disappears, later its missing trials count as aborted. `errors` holds its id. Or a model "
        "was handed in for an agent that has begun the suite."
    ),
    ProblemType.EVALUATION_FINISHED: "Every trial of the evaluation has a verdict.",
    ProblemType.EVALUATION_CANCELLED: "The evaluation was cancelled by its agent.",
    ProblemType.SUBMISSIONS_UNAVAILABLE: (
        "This service takes no submissions: it has no sandbox for models, or its operator has turned them off. "
        "Drive the agent yourself: wrongturn run."
    ),
    ProblemType.NO_TRIAL_AVAILABLE: "No trial is available now: too many are open, or the rest are twins of open ones.",
    ProblemType.EPISODE_FINISHED: "The episode is over.",
    ProblemType.EPISODE_LOST: "The service lost the episode. It does not count, and its trial runs again.",
    ProblemType.EPISODE_NOT_SHOWN: "The episode is shown once it, and its whole evaluation, is finished.",
    ProblemType.SEQUENCE_GAP: "The seq of a step is the last one plus 1, or the last one again.",
    ProblemType.ACTION_MISMATCH: "The step was already taken with another action.",
    ProblemType.RESULTS_MISMATCH: "The worker's record differs from what the service saw.",
    ProblemType.SIMULATORS_BUSY: (
        "All simulators are busy. The call waits in a queue: `position` says how many simulators have to become free "
        "first. Send the same call, with the same Idempotency-Key, after Retry-After seconds to keep its place. Agents "
        "with fewer simulators come first."
    ),
    ProblemType.SIMULATOR_FAILED: "No simulator could begin the episode. The operator's log says why.",
    ProblemType.STORAGE_FAILED: "The database failed, or the disk is full. Nothing of the call was stored.",
    ProblemType.SERVICE_FULL: "The service has too many connections. Come back after Retry-After seconds.",
    ProblemType.SHUTTING_DOWN: "The service is stopping. Come back once it runs again.",
    ProblemType.INTERNAL: "The service made a mistake. The operator's log has the details.",
}
router = APIRouter(tags=["problems"])


@router.get("/problems/{kind}", **described(None, 404, media="text/plain"))
async def explain(kind: str) -> Response:
    """Explain a problem type."""
    if kind not in _EXPLANATIONS:
        raise ServiceError(ProblemType.UNKNOWN_ROUTE, f"there is no problem type {kind[:64]!r}", status=404)
    found = ProblemType(kind)
    return Response(f"{title(found)}\n\n{_EXPLANATIONS[found]}\n", media_type="text/plain")


def problem_response(error: ServiceError) -> Response:
    """Return the response for an error."""
    response = reply(error.problem(), error.status)
    response.headers.update(error.headers)
    response.headers["Content-Type"] = MEDIA_TYPE
    return response


def response_for(request: Request, error: ServiceError) -> Response:
    """Return the response for an error: a page for a browser that asked for one, else a problem."""
    return error_page(request, error) if wants_page(request) else problem_response(error)


def as_service_error(error: Exception) -> ServiceError:
    """Return the error that the caller sees for an exception."""
    match error:
        case ServiceError():
            return error
        case SimulatorsBusyError():
            return UnavailableError(
                ProblemType.SIMULATORS_BUSY, f"{error}; come back later", retry_after_s=2, position=error.position
            )
        case SimulatorStartError():
            _log.error("simulator start failed", reason=str(error))
            return UnavailableError(ProblemType.SIMULATOR_FAILED, "no simulator could be started", retry_after_s=5)
        case EpisodeRefusedError():
            return _refused_episode(error)
        case HolderGoneError():
            return UnauthenticatedError("the holder of this token was deleted by the operator")
        case SQLAlchemyError():
            _log.error("storage failed", reason=str(getattr(error, "orig", None) or error))
            return UnavailableError(
                ProblemType.STORAGE_FAILED,
                "the database failed and nothing was changed; send the request again",
                retry_after_s=5,
            )
        case RequestValidationError():
            fields = [
                FieldError(path=".".join(str(part) for part in item["loc"]), message=item["msg"])
                for item in error.errors()
            ]
            detail = "; ".join(f"{field.path}: {field.message}" for field in fields[:3])
            return ServiceError(ProblemType.VALIDATION, detail, status=422, errors=fields)
        case HTTPException():
            return _http_error(error)
        case ClientDisconnect():
            return ServiceError(ProblemType.MALFORMED_BODY, "the client left before the body was complete", status=400)
        case _:
            _log.error("internal error", exc_info=error)
            return ServiceError(ProblemType.INTERNAL, "the service made a mistake; the operator's log has the details")


def _refused_episode(error: EpisodeRefusedError) -> ServiceError:
    if error.name == "TrafficTooDenseError":
        return InvalidRequestError(str(error).split(":", 1)[0], str(error))
    return InvalidRequestError("fault", str(error), ProblemType.FAULT_NOT_APPLICABLE)


def _http_error(error: HTTPException) -> ServiceError:
    kinds = {
        404: (ProblemType.UNKNOWN_ROUTE, "there is no such call; see /openapi.json"),
        405: (ProblemType.METHOD_NOT_ALLOWED, "the path does not take this method; Allow names those that it takes"),
    }
    kind, detail = kinds.get(error.status_code, (ProblemType.MALFORMED_BODY, str(error.detail)))
    if error.status_code >= 500:
        kind = ProblemType.INTERNAL
    return ServiceError(kind, detail, status=error.status_code, headers=error.headers)


async def _handle(request: Request, error: Exception) -> Response:
    if isinstance(error, HTTPException) and error.status_code == 404 and (way := page_without_slash(request)):
        return way
    found = as_service_error(error)
    if found.kind is ProblemType.METHOD_NOT_ALLOWED:
        # Starlette names only the methods of the path's first route.
        methods = await asyncio.to_thread(methods_at, request.app, request.scope["path"])
        if methods:
            found.headers["Allow"] = ", ".join(methods)
    return response_for(request, found)


async def _repeat(_: Request, error: Exception) -> Response:
    assert isinstance(error, StoredReplyError)
    return stored_reply(error)


def install(app: FastAPI) -> None:
    """Register the handler for all expected exceptions. The middleware catches the others."""
    for kind in (
        ServiceError,
        SimulatorsBusyError,
        SimulatorStartError,
        EpisodeRefusedError,
        HolderGoneError,
        SQLAlchemyError,
        RequestValidationError,
        HTTPException,
    ):
        app.add_exception_handler(kind, _handle)
    app.add_exception_handler(StoredReplyError, _repeat)
    assert set(_EXPLANATIONS) == set(ProblemType)
