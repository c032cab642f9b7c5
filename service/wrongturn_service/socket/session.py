"""``WS /v1/drive``: many episodes over one connection; :mod:`wrongturn_protocol.wire` describes the messages."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Final

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect

from wrongturn_protocol import ProblemType, wire
from wrongturn_service.accounts import Caller
from wrongturn_service.api.errors import as_service_error, problem_response
from wrongturn_service.client_address import address_of
from wrongturn_service.encoding import Reply
from wrongturn_service.episodes.open_episode import stopping
from wrongturn_service.errors import ServiceError, UnauthenticatedError
from wrongturn_service.service import Service
from wrongturn_service.socket.calls import Calls, problem_result
from wrongturn_service.socket.protocol import EXTENSION, DirectWebSocket

router = APIRouter()
_CLOSE_CODES: Final = {
    ProblemType.TEXT_MESSAGE: 1003,
    ProblemType.TRUNCATED_MESSAGE: 1007,
    ProblemType.MALFORMED_MESSAGE: 1007,
    ProblemType.UNAUTHENTICATED: 1008,
    ProblemType.MESSAGE_TOO_LARGE: 1009,
}
"""Codes that close the connection after a problem (RFC 6455, 7.4.1); the close's reason is the problem's type."""
_FAILED: Final = 1011


@router.websocket(wire.PATH)
async def drive(websocket: WebSocket) -> None:
    """Accept the connection, or refuse it as over HTTP; then answer messages until either side closes it."""
    service: Service = websocket.app.state.service
    with contextlib.ExitStack() as stack:
        try:
            _check_version(websocket)
            caller = await service.accounts.caller(websocket.headers.get("authorization"))
            address = address_of(websocket)
            stack.enter_context(service.sockets.one(caller.holder, address))
        except Exception as error:
            await websocket.send_denial_response(problem_response(as_service_error(error)))
            return
        direct: DirectWebSocket = websocket.scope["extensions"][EXTENSION]
        connection = Connection(websocket, direct, service, caller, address)
        direct.receive_messages(connection.receive)
        await websocket.accept(subprotocol=wire.SUBPROTOCOL)
        await connection.serve()


def _check_version(websocket: WebSocket) -> None:
    offered: list[str] = websocket.scope.get("subprotocols", [])
    if wire.SUBPROTOCOL not in offered:
        versions = ", ".join(offered)[:200] or "none"
        raise ServiceError(
            ProblemType.PROTOCOL_VERSION,
            f"Sec-WebSocket-Protocol: this service speaks {wire.SUBPROTOCOL}, the client offered {versions}; "
            "use a client of the same version, or HTTP",
            status=426,
            headers={"Upgrade": "websocket", "Sec-WebSocket-Protocol": wire.SUBPROTOCOL},
        )


class _Answer:
    """The answer to a message: the results that are there, and how many are missing."""

    __slots__ = ("missing", "number", "results")

    def __init__(self, number: int, count: int) -> None:
        self.number = number
        self.results: list[bytes | Reply] = [b""] * count
        self.missing = count


class Connection:
    """One client's connection.

    Messages are answered independently, each as soon as all of its calls are. The connection stops reading while
    :data:`wire.CALLS` calls are being answered or replies are not read, so a client that sends without end has to wait.
    """

    def __init__(
        self, websocket: WebSocket, direct: DirectWebSocket, service: Service, caller: Caller, address: str
    ) -> None:
        self._websocket = websocket
        self._direct = direct
        self._service = service
        self._caller = caller
        self._known_at = service.accounts.changes
        self._calls = Calls(service, caller, address)
        self._answering = 0
        self._waiting: tuple[int, list[Any]] | None = None
        self._checking = False
        self._queued: Counter[str] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()
        self._closing = False
        self._answered_all = asyncio.Event()

    async def serve(self) -> None:
        """Wait until either side closes, then until all calls are answered, so that they can be repeated elsewhere."""
        try:
            while (await self._websocket.receive())["type"] != "websocket.disconnect":
                # Binary messages go to :meth:`receive`.
                await self._refuse(
                    ServiceError(ProblemType.TEXT_MESSAGE, "messages are binary, this one was text", status=400)
                )
        finally:
            self._closing = True
            while self._answering:
                self._answered_all.clear()
                await self._answered_all.wait()

    def receive(self, data: bytes) -> None:
        """Answer a binary message."""
        if self._closing:
            return
        if self._service.accounts.changes != self._known_at:
            self._checking = True
            self._spawn(self._check_again(data))
        else:
            try:
                number, calls = self._unpacked(data)
            except ServiceError as error:
                self._closing = True
                self._spawn(self._refuse(error))
            else:
                if self._answering and self._answering + len(calls) > wire.CALLS:
                    self._waiting = number, calls
                else:
                    self._begin(number, calls)
        self._pace()

    def _unpacked(self, data: bytes) -> tuple[int, list[Any]]:
        """Return a message's number and calls. Raises ServiceError."""
        if len(data) > wire.LARGEST:
            raise ServiceError(
                ProblemType.MESSAGE_TOO_LARGE,
                f"the message has {len(data)} bytes, at most {wire.LARGEST} are taken; send fewer calls at a time",
                status=413,
            )
        try:
            return wire.unpack_calls(data)
        except wire.TruncatedMessageError as error:
            raise ServiceError(ProblemType.TRUNCATED_MESSAGE, str(error), status=400) from error
        except wire.MalformedMessageError as error:
            raise ServiceError(ProblemType.MALFORMED_MESSAGE, str(error), status=400) from error

    async def _check_again(self, data: bytes) -> None:
        """Check the token again before a message, as over HTTP: a revoked one closes the connection."""
        accounts = self._service.accounts
        changes = accounts.changes
        try:
            caller = await accounts.caller(self._websocket.headers.get("authorization"))
            if caller != self._caller:
                raise UnauthenticatedError("the token is good for something else by now; connect again")
        except Exception as error:
            self._closing = True
            await self._refuse(as_service_error(error))
            return
        self._known_at, self._checking = changes, False
        self.receive(data)

    def _begin(self, number: int, calls: list[Any]) -> None:
        self._answering += len(calls)
        answer = _Answer(number, len(calls))
        for at, call in enumerate(calls):
            done = partial(self._take_result, answer, at)
            episode = _episode_of(call)
            # The short way must not overtake an earlier call on the same episode.
            if episode in self._queued or not self._calls.begin(call, done):
                self._queued[episode] += 1
                self._spawn(self._answer(call, episode, done))

    async def _answer(self, call: Any, episode: str, done: Callable[[bytes | Reply], None]) -> None:
        # The result if the service stops before there is another one.
        result = problem_result(stopping())
        try:
            result = await self._calls.answer(call)
        finally:
            self._queued -= Counter([episode])
            done(result)

    def _take_result(self, answer: _Answer, at: int, result: bytes | Reply) -> None:
        answer.results[at] = result
        answer.missing -= 1
        if not answer.missing:
            pieces = [wire.results_head(answer.number, len(answer.results))]
            for one in answer.results:
                if isinstance(one, bytes):
                    pieces.append(one)
                else:
                    pieces += one.pieces()
            self._direct.send_message(pieces)
        self._answering -= 1
        if self._waiting is not None and (not self._answering or self._answering + len(self._waiting[1]) <= wire.CALLS):
            (number, calls), self._waiting = self._waiting, None
            self._begin(number, calls)
        self._pace()
        if not self._answering:
            self._answered_all.set()

    def _pace(self) -> None:
        self._direct.set_busy(self._checking or self._waiting is not None or self._answering >= wire.CALLS)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _refuse(self, error: ServiceError) -> None:
        self._closing = True
        self._direct.send_message([wire.join_results(None, [problem_result(error)])])
        # The client may have left meanwhile.
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await self._websocket.close(_CLOSE_CODES.get(error.kind, _FAILED), error.kind.value)


def _episode_of(call: Any) -> str:
    """Return the episode that a call is about; for other calls, any string that they hold in its place."""
    if isinstance(call, list) and len(call) > 1 and isinstance(call[1], str):
        return call[1]
    return ""
