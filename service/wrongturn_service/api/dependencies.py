"""What routes declare as dependencies: the service, the caller, the body, the key and the reply's encoding.

Declare them in the order in which they are to be checked: FastAPI resolves them in the order of the parameters.
:class:`~wrongturn_service.api.documents.Route` reads the OpenAPI document's entries from the same declarations.
"""

import hashlib
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager
from functools import lru_cache
from typing import Annotated, Final, Generic, TypeVar

from fastapi import Depends, Header, Request, Response, Security
from fastapi.openapi.models import HTTPBearer
from fastapi.security.base import SecurityBase
from pydantic import BaseModel, WithJsonSchema

from wrongturn_protocol import ProblemType
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.accounts import Caller
from wrongturn_service.api.body import parsed
from wrongturn_service.encoding import Encoding
from wrongturn_service.errors import ServiceError, unknown
from wrongturn_service.idempotency import HEADER, IdempotentRequest
from wrongturn_service.service import Service
from wrongturn_service.storage.models import EvaluationRow

M = TypeVar("M", bound=BaseModel)


async def service_of(request: Request) -> Service:
    """Return the service behind the application."""
    service: Service = request.app.state.service
    return service


class Token(SecurityBase):
    """Finds the agent whose bearer token the request holds. Raises UnauthenticatedError, ForbiddenError.

    With ``runners`` a runner's token is taken too. Then the route checks what the token is good for.
    """

    def __init__(self, *, runners: bool = False) -> None:
        self.runners = runners
        self.model = HTTPBearer(
            description="An agent's token, from POST /v1/agents, or an owner's, from POST /v1/owners"
        )
        self.scheme_name = "token"

    async def __call__(self, request: Request) -> Caller:
        """Return the agent."""
        caller = await (await service_of(request)).accounts.caller(request.headers.get("authorization"))
        if not self.runners:
            caller.check_agent()
        return caller


class AnyToken(Token):
    """Reads the ``Authorization`` header of calls that take an agent's token or the operator's."""

    async def __call__(self, request: Request) -> str | None:  # type: ignore[override]
        """Return the header."""
        return request.headers.get("authorization")


class Body(Generic[M]):
    """Reads and checks the request's body, see :func:`~wrongturn_service.api.body.parsed`.

    ``limit`` may also be a function that returns the most bytes for a request.
    """

    def __init__(
        self, model: type[M], *, limit: int | Callable[[Request], Awaitable[int]], binary: bool = False
    ) -> None:
        self.model = model
        self.binary = binary
        self._limit = limit

    async def __call__(self, request: Request) -> M:
        """Return the message."""
        limit = self._limit if isinstance(self._limit, int) else await self._limit(request)
        return await parsed(request, self.model, limit=limit, binary=self.binary)


class RequestKey:
    """The request's ``Idempotency-Key``, or its absence."""

    def __init__(
        self,
        request: Request,
        value: Annotated[
            str | None,
            WithJsonSchema({"type": "string", "minLength": 1, "maxLength": 255, "pattern": "^[ -~]+$"}),
            Header(
                alias=HEADER,
                description="A random UUID. A repeat gets the stored reply, with a new token if it had one",
            ),
        ] = None,
    ) -> None:
        self.value = value
        self._service: Service = request.app.state.service
        self._call = f"{request.method} {request.url.path}"

    def once(self, scope: str, body: BaseModel | None = None) -> AbstractAsyncContextManager[IdempotentRequest]:
        """Run a block once for each key of a scope, usually the caller's id; see :meth:`Idempotency.once`."""
        content = b"" if body is None else body.model_dump_json().encode()
        return self._service.idempotency.once(self.value, scope, self._call, content)


async def accepted(request: Request) -> Encoding:
    """Return the encoding that the client wants for the reply. Raises ServiceError (406)."""
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
    best, found = 0.0, None
    for media, weight in weights(accept if accept.strip() else "*/*"):
        if media in _ACCEPTED and weight > best:
            best, found = weight, _ACCEPTED[media]
    return found


def weights(accept: str) -> Iterator[tuple[str, float]]:
    """Yield each media type of an ``Accept`` header with its weight."""
    for item in accept.split(","):
        media, *parameters = (part.strip().lower() for part in item.split(";"))
        weight = next((parameter[2:] for parameter in parameters if parameter.startswith("q=")), "1")
        try:
            yield media, float(weight)
        except ValueError:
            yield media, 0.0


_ACCEPTED: Final = {
    "*/*": Encoding.JSON,
    "application/*": Encoding.JSON,
    "application/json": Encoding.JSON,
    "application/msgpack": Encoding.MSGPACK,
    "application/x-msgpack": Encoding.MSGPACK,
}


ServiceDep = Annotated[Service, Depends(service_of)]
CallerDep = Annotated[Caller, Security(Token())]
"""The agent itself."""
DriverDep = Annotated[Caller, Security(Token(runners=True))]
"""The agent, or the runner of its submission. The route checks what a runner's token is good for."""
AuthorizationDep = Annotated[str | None, Security(AnyToken())]
EncodingDep = Annotated[Encoding, Depends(accepted)]
KeyDep = Annotated[RequestKey, Depends()]


async def owned_by(service: Service, caller: Caller, evaluation_id: str) -> EvaluationRow:
    """Return an evaluation that the caller may see. Raises NotFoundError, ForbiddenError."""
    row = await service.store.evaluation(evaluation_id)
    if row is None:
        raise unknown(Collection.EVALUATIONS, evaluation_id)
    caller.check_sees(row)
    return row


async def driven_by(service: Service, caller: Caller, evaluation_id: str) -> EvaluationRow:
    """Return an evaluation that the caller may drive or close. Raises NotFoundError, ForbiddenError."""
    row = await owned_by(service, caller, evaluation_id)
    caller.check_drives(row)
    return row


def reply(message: BaseModel, status: int = 200) -> Response:
    """Return a response with a message as JSON."""
    return Response(message.model_dump_json(), status, media_type=Encoding.JSON)


def tagged(
    request: Request, body: bytes, media_type: str, headers: Mapping[str, str], *, status: int = 200, tag: str = ""
) -> Response:
    """Return the reply with a body; 304, with the same headers, if the status is 200 and the caller has it already.

    ``tag`` is the body's ETag, if it is known already.
    """
    tag = tag or f'"{hashlib.sha256(body).hexdigest()[:32]}"'
    named = {**headers, "ETag": tag}
    # If-None-Match names tags alone, in a list, as weak ones, or by ``*``.
    there = {part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")}
    if status == 200 and not there.isdisjoint({tag, "*"}):
        return Response(status_code=304, headers=named)
    return Response(body, status, named, media_type)
