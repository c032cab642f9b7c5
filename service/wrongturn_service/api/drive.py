"""``WS /v1/drive``: many episodes over one connection, as :mod:`wrongturn_protocol.wire` has it."""

import asyncio
import contextlib
from typing import Any, Final

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect

from wrongturn_protocol import ProblemType, wire
from wrongturn_service.accounts import Caller
from wrongturn_service.api.dependencies import address_of
from wrongturn_service.api.drive_calls import Calls, problem_result
from wrongturn_service.api.errors import as_service_error, problem_response
from wrongturn_service.errors import ServiceError, UnauthenticatedError
from wrongturn_service.service import Service

router = APIRouter()
_CLOSE_CODES: Final = {
    ProblemType.TEXT_MESSAGE: 1003,
    ProblemType.TRUNCATED_MESSAGE: 1007,
    ProblemType.MALFORMED_MESSAGE: 1007,
    ProblemType.UNAUTHENTICATED: 1008,
    ProblemType.MESSAGE_TOO_LARGE: 1009,
}
"""What the connection is closed with after these (RFC 6455, 7.4.1); the close's reason is the problem's type."""
_FAILED: Final = 1011


@router.websocket(wire.PATH)
async def drive(websocket: WebSocket) -> None:
    """Shake hands, or refuse as over HTTP; then answer until either side closes."""
    service: Service = websocket.app.state.service
    with contextlib.ExitStack() as stack:
        try:
            _check_version(websocket)
            caller = await service.accounts.caller(websocket.headers.get("authorization"))
            stack.enter_context(service.sockets.one(caller.id, address_of(websocket)))
        except Exception as error:
            await websocket.send_denial_response(problem_response(as_service_error(error)))
            return
        await websocket.accept(subprotocol=wire.SUBPROTOCOL)
        await Connection(websocket, service, caller).serve()


def _check_version(websocket: WebSocket) -> None:
    offered: list[str] = websocket.scope.get("subprotocols", [])
    if wire.SUBPROTOCOL not in offered:
        said = ", ".join(offered)[:200] or "none"
        raise ServiceError(
            ProblemType.PROTOCOL_VERSION,
            f"Sec-WebSocket-Protocol: this service speaks {wire.SUBPROTOCOL}, the client offered {said}; "
            "use a client of the same version, or HTTP",
            status=426,
            headers={"Upgrade": "websocket", "Sec-WebSocket-Protocol": wire.SUBPROTOCOL},
        )


class Connection:
    """One client's.

    Messages are answered side by side, each when all of its calls are. No more is read while as many calls as are
    allowed are being answered, so that a client that asks without end waits in its own network buffers; and no reply
    is put on top of those that it does not read.
    """

    def __init__(self, websocket: WebSocket, service: Service, caller: Caller) -> None:
        self._websocket = websocket
        self._service = service
        self._caller = caller
        self._calls = Calls(service, caller)
        self._answering = 0
        self._freed = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()

    async def serve(self) -> None:
        """Answer until either side closes; what was begun is brought to its end, so that it can be asked for again."""
        try:
            while True:
                event = await self._websocket.receive()
                if event["type"] == "websocket.disconnect":
                    return
                try:
                    number, calls = await self._opened(event)
                except Exception as error:
                    await self._refuse(as_service_error(error))
                    return
                while self._answering and self._answering + len(calls) > wire.CALLS:
                    self._freed.clear()
                    await self._freed.wait()
                self._answering += len(calls)
                task = asyncio.create_task(self._answer(number, calls))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        finally:
            if self._tasks:
                await asyncio.wait(self._tasks)

    async def _opened(self, event: Any) -> tuple[int, list[Any]]:
        """Number and calls of a message. Raises ServiceError."""
        data = event.get("bytes")
        if data is None:
            raise ServiceError(ProblemType.TEXT_MESSAGE, "messages are binary, this one was text", status=400)
        limit = self._service.settings.body_limit
        if len(data) > limit:
            raise ServiceError(
                ProblemType.MESSAGE_TOO_LARGE,
                f"the message has {len(data)} bytes, at most {limit} are taken; send fewer calls at a time",
                status=413,
            )
        # As with every request over HTTP: a token that was revoked ends what was begun with it.
        caller = await self._service.accounts.caller(self._websocket.headers.get("authorization"))
        if caller.id != self._caller.id:
            raise UnauthenticatedError("the token is another agent's by now")
        try:
            return wire.unpack_calls(data)
        except wire.TruncatedMessageError as error:
            raise ServiceError(ProblemType.TRUNCATED_MESSAGE, str(error), status=400) from error
        except wire.MalformedMessageError as error:
            raise ServiceError(ProblemType.MALFORMED_MESSAGE, str(error), status=400) from error

    async def _answer(self, number: int, calls: list[Any]) -> None:
        try:
            if len(calls) == 1:
                results = [await self._calls.answer(calls[0])]
            else:
                results = await asyncio.gather(*map(self._calls.answer, calls))
            await self._send(wire.join_results(number, results))
        finally:
            self._answering -= len(calls)
            self._freed.set()

    async def _send(self, message: bytes) -> None:
        # Who has left meanwhile asks again over another connection.
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await self._websocket.send_bytes(message)

    async def _refuse(self, error: ServiceError) -> None:
        await self._send(wire.join_results(None, [problem_result(error)]))
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await self._websocket.close(_CLOSE_CODES.get(error.kind, _FAILED), error.kind.value)
