"""One handler: whatever goes wrong becomes ``application/problem+json`` of a type from the closed list."""

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
from wrongturn_service.errors import InvalidRequestError, ServiceError, UnavailableError, title
from wrongturn_service.simulators.interface import EpisodeRefusedError, SimulatorsBusyError, SimulatorStartError

MEDIA_TYPE = "application/problem+json"
_log = structlog.get_logger("errors")
_EXPLANATIONS = {
    ProblemType.MALFORMED_BODY: "The body is no JSON, or no msgpack where its Content-Type says so.",
    ProblemType.VALIDATION: "A field is missing, unknown, of another type or out of its range; errors names each.",
    ProblemType.UNAUTHENTICATED: "The call needs a bearer token and had none, or one that nobody has.",
    ProblemType.FORBIDDEN: "The token is good, but what was asked for is another's, or the operator's.",
    ProblemType.UNKNOWN_ROUTE: "There is no such call; see /openapi.json.",
    ProblemType.METHOD_NOT_ALLOWED: "The path is right and the method is not; Allow names those that are.",
    ProblemType.NOT_ACCEPTABLE: "Accept names neither application/json nor application/msgpack.",
    ProblemType.UNSUPPORTED_MEDIA_TYPE: "The body's Content-Type is none that the call takes.",
    ProblemType.BODY_TOO_LARGE: "The body is larger than the service takes.",
    ProblemType.REQUEST_TIMEOUT: "The request, or a message of /v1/drive, did not come to its end in time.",
    ProblemType.PROTOCOL_VERSION: "The handshake of /v1/drive names no version of the protocol that is spoken here.",
    ProblemType.TEXT_MESSAGE: "A message of /v1/drive was text; they are binary.",
    ProblemType.MESSAGE_TOO_LARGE: "A message of /v1/drive is larger than the service takes.",
    ProblemType.TRUNCATED_MESSAGE: "A message of /v1/drive ends before it is complete.",
    ProblemType.MALFORMED_MESSAGE: "A message of /v1/drive is no msgpack, or none of its protocol.",
    ProblemType.UNKNOWN_SUITE: "There is no suite of this id; GET /v1/suites lists them.",
    ProblemType.UNKNOWN_TOWN: "There is no town of this name; GET /v1/towns lists them.",
    ProblemType.UNKNOWN_APPROACH: "The town has no such approach; GET /v1/towns/{town} lists them.",
    ProblemType.UNKNOWN_TRIAL: "The suite has no such trial; GET /v1/suites/{suite}/trials lists them.",
    ProblemType.UNKNOWN_AGENT: "There is no agent of this id.",
    ProblemType.UNKNOWN_EVALUATION: "There is no evaluation of this id.",
    ProblemType.UNKNOWN_EPISODE: "There is no episode of this id.",
    ProblemType.FAULT_NOT_APPLICABLE: "The fault is not there yet, or this approach does not admit it.",
    ProblemType.TRACK_NOT_AVAILABLE: "The track's sensors are not there, or the suite is not of this track.",
    ProblemType.AGENT_NAME_TAKEN: "Another agent has this name; names that differ in case alone are the same.",
    ProblemType.REGISTRATION_CLOSED: "Only the operator registers agents at this service.",
    ProblemType.RATE_LIMITED: (
        "Too many of these for now; come back after Retry-After seconds. Where there is a position, so many of one's "
        "own have to end before."
    ),
    ProblemType.IDEMPOTENCY_KEY_REUSED: "The Idempotency-Key was sent with another request before.",
    ProblemType.EVALUATION_FINISHED: "Each trial of the evaluation has its verdict.",
    ProblemType.EVALUATION_CANCELLED: "The evaluation was cancelled.",
    ProblemType.NO_TRIAL_AVAILABLE: "For now no trial can be handed out: their twins are open, or too many are.",
    ProblemType.EPISODE_FINISHED: "The episode has had its last step.",
    ProblemType.EPISODE_LOST: "The episode is gone by the service's own fault; its trial runs again.",
    ProblemType.EPISODE_NOT_SHOWN: "It is shown once the episode, and in an evaluation the whole of it, is finished.",
    ProblemType.SEQUENCE_GAP: "A step's seq is the last one received plus 1, or that one again.",
    ProblemType.ACTION_MISMATCH: "The step was taken before, with another action.",
    ProblemType.RESULTS_MISMATCH: "The worker's record differs from what the service saw.",
    ProblemType.SIMULATORS_BUSY: (
        "All simulators drive. The call has a place in the line for one: position says how many have to become free "
        "until it is its turn, 1 the next. The place is kept for the same call, by its Idempotency-Key where it has "
        "one, that comes back after Retry-After seconds. Agents with fewer simulators come first, else who came first."
    ),
    ProblemType.SIMULATOR_FAILED: "No simulator could begin the episode; the operator's log says why.",
    ProblemType.STORAGE_FAILED: "The database did not take or give what was asked; nothing was half done.",
    ProblemType.SERVICE_FULL: "The service has as many connections as it may; come back after Retry-After seconds.",
    ProblemType.SHUTTING_DOWN: "The service is about to end; come back when it was started again.",
    ProblemType.INTERNAL: "A mistake of the service; the operator's log has the details.",
}
router = APIRouter(tags=["problems"])


@router.get("/problems/{kind}", **described(None, 404, media="text/plain"))
async def explain(kind: str) -> Response:
    """What a problem's type means."""
    if kind not in _EXPLANATIONS:
        raise ServiceError(ProblemType.UNKNOWN_ROUTE, f"there is no problem type {kind[:64]!r}", status=404)
    found = ProblemType(kind)
    return Response(f"{title(found)}\n\n{_EXPLANATIONS[found]}\n", media_type="text/plain")


def problem_response(error: ServiceError) -> Response:
    """An error on the wire."""
    response = reply(error.problem(), error.status)
    response.headers.update(error.headers)
    response.headers["Content-Type"] = MEDIA_TYPE
    return response


def as_service_error(error: Exception) -> ServiceError:
    """What an exception is for the caller."""
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
        case SQLAlchemyError():
            _log.error("storage failed", reason=str(getattr(error, "orig", None) or error))
            return UnavailableError(
                ProblemType.STORAGE_FAILED,
                "the database did not do what was asked; nothing was half done, send it again",
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
            return ServiceError(ProblemType.MALFORMED_BODY, "the client left before the body's end", status=400)
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
        405: (ProblemType.METHOD_NOT_ALLOWED, "the path is right and the method is not; Allow names those that are"),
    }
    kind, detail = kinds.get(error.status_code, (ProblemType.MALFORMED_BODY, str(error.detail)))
    if error.status_code >= 500:
        kind = ProblemType.INTERNAL
    return ServiceError(kind, detail, status=error.status_code, headers=error.headers)


async def _handle(request: Request, error: Exception) -> Response:
    found = as_service_error(error)
    if found.kind is ProblemType.METHOD_NOT_ALLOWED:
        # Starlette names those of the first route of this path alone.
        methods = await asyncio.to_thread(methods_at, request.app, request.scope["path"])
        if methods:
            found.headers["Allow"] = ", ".join(methods)
    return problem_response(found)


async def _repeat(_: Request, error: Exception) -> Response:
    assert isinstance(error, StoredReplyError)
    return stored_reply(error)


def install(app: FastAPI) -> None:
    """Let the one handler have every exception that is expected; what is not, the middleware catches."""
    for kind in (
        ServiceError,
        SimulatorsBusyError,
        SimulatorStartError,
        EpisodeRefusedError,
        SQLAlchemyError,
        RequestValidationError,
        HTTPException,
    ):
        app.add_exception_handler(kind, _handle)
    app.add_exception_handler(StoredReplyError, _repeat)
    assert set(_EXPLANATIONS) == set(ProblemType)
