"""What the calls share: the service, the caller, the encoding of the reply."""

from functools import lru_cache

from fastapi import Request, Response
from pydantic import BaseModel
from starlette.requests import HTTPConnection

from wrongturn_protocol import ProblemType
from wrongturn_service.accounts import Caller
from wrongturn_service.encoding import Encoding
from wrongturn_service.errors import ForbiddenError, NotFoundError, ServiceError
from wrongturn_service.idempotency import HEADER
from wrongturn_service.service import Service
from wrongturn_service.storage.models import EvaluationRow, IdempotencyRow


def service_of(request: Request) -> Service:
    """The service behind the application."""
    service: Service = request.app.state.service
    return service


async def caller_of(request: Request) -> Caller:
    """The agent whose token came along. Raises UnauthenticatedError."""
    return await service_of(request).accounts.caller(request.headers.get("authorization"))


async def owned_evaluation(request: Request, caller: Caller, evaluation_id: str) -> EvaluationRow:
    """The caller's evaluation. Raises NotFoundError, ForbiddenError."""
    return await owned_by(service_of(request), caller, evaluation_id)


async def owned_by(service: Service, caller: Caller, evaluation_id: str) -> EvaluationRow:
    """The caller's evaluation. Raises NotFoundError, ForbiddenError."""
    row = await service.store.evaluation(evaluation_id)
    if row is None:
        raise NotFoundError(ProblemType.UNKNOWN_EVALUATION, f"there is no evaluation {evaluation_id[:64]!r}")
    if row.agent_id != caller.id:
        raise ForbiddenError(f"evaluation {evaluation_id} is another agent's")
    return row


def key_of(request: Request) -> str | None:
    """The idempotency key, or None."""
    return request.headers.get(HEADER)


def address_of(request: HTTPConnection) -> str:
    """Where a request or connection came from; what a trusted proxy says, where there is one before."""
    return request.client.host if request.client is not None else "unknown"


def accepted(request: Request) -> Encoding:
    """The encoding that the client wants. Raises ServiceError (406)."""
    encoding = _negotiated(request.headers.get("accept", ""))
    if encoding is None:
        raise ServiceError(
            ProblemType.NOT_ACCEPTABLE,
            "replies are application/json or application/msgpack; name one of them in Accept",
            status=406,
        )
    return encoding


@lru_cache(maxsize=256)
def _negotiated(accept: str) -> Encoding | None:
    best: tuple[float, Encoding] | None = None
    for item in accept.split(",") if accept.strip() else ["*/*"]:
        media, *parameters = (part.strip().lower() for part in item.split(";"))
        encoding = _ACCEPTED.get(media)
        weight = _weight(parameters)
        if encoding is not None and weight > 0 and (best is None or weight > best[0]):
            best = (weight, encoding)
    return None if best is None else best[1]


_ACCEPTED = {
    "*/*": Encoding.JSON,
    "application/*": Encoding.JSON,
    "application/json": Encoding.JSON,
    "application/msgpack": Encoding.MSGPACK,
    "application/x-msgpack": Encoding.MSGPACK,
}


def _weight(parameters: list[str]) -> float:
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return float(parameter[2:])
            except ValueError:
                return 0.0
    return 1.0


def reply(message: BaseModel, status: int = 200) -> Response:
    """A message as JSON."""
    return Response(message.model_dump_json(), status, media_type=Encoding.JSON)


def repeated(stored: IdempotencyRow) -> Response:
    """The reply that was stored for an idempotency key."""
    return Response(stored.body, stored.status, media_type=stored.content_type)
