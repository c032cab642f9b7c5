"""The handler of all errors: each becomes ``application/problem+json`` with a type from the closed list."""

import orjson
import structlog
from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.api.dependencies import reply
from wrongturn_service.api.documents import WORDS, described
from wrongturn_service.errors import InvalidRequestError, ServiceError, UnauthenticatedError, UnavailableError, title
from wrongturn_service.idempotency import StoredReplyError
from wrongturn_service.simulators.interface import EpisodeRefusedError, SimulatorsBusyError, SimulatorStartError
from wrongturn_service.storage.accounts import HolderGoneError
from wrongturn_service.web.errors import error_page, page_without_slash, wants_page

MEDIA_TYPE = "application/problem+json"
_log = structlog.get_logger("errors")
router = APIRouter(tags=["problems"])


@router.get("/problems/{kind}", **described(None, 404, media="text/plain"))
async def explain(kind: str) -> Response:
    """Explain a problem type."""
    if kind not in WORDS["problems"]:
        raise ServiceError(ProblemType.UNKNOWN_ROUTE, f"there is no problem type {kind[:64]!r}", status=404)
    found = ProblemType(kind)
    return Response(f"{title(found)}\n\n{WORDS['problems'][kind]}\n", media_type="text/plain")


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
        found.headers["Allow"] = ", ".join(
            method
            for method in ("DELETE", "GET", "HEAD", "POST", "PUT")
            if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in request.app.routes)
        )
    return response_for(request, found)


async def _repeat(request: Request, error: Exception) -> Response:
    """Send a stored reply again, with a new token if it had one."""
    assert isinstance(error, StoredReplyError)
    stored, body = error.stored, error.stored.body
    if stored.with_token:
        token = await request.app.state.service.accounts.renew(stored)
        body = orjson.dumps({**orjson.loads(body), "token": token})
    return Response(body, stored.status, media_type=stored.content_type)


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
