"""``WS /v1/drive``: many episodes over one connection, as :mod:`wrongturn_protocol.wire` has it."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Final

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect

from wrongturn_protocol import ProblemType, wire
from wrongturn_protocol.wire import Call
from wrongturn_service.accounts import Caller
from wrongturn_service.api.dependencies import address_of
from wrongturn_service.api.errors import as_service_error, problem_response
from wrongturn_service.encoding import Reply
from wrongturn_service.episodes.refusals import stopping
from wrongturn_service.episodes.steps import Done
from wrongturn_service.errors import ServiceError, UnauthenticatedError
from wrongturn_service.service import Service
from wrongturn_service.simulators.interface import LastStep, LoanResult
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
"""What the connection is closed with after these (RFC 6455, 7.4.1); the close's reason is the problem's type."""
_FAILED: Final = 1011
_STREAK: Final = 2
"""Steps of one episode, with nothing between them, after which its simulator answers them itself."""
_IN_VAIN: Final = 32
"""As many more where the last loan ended with its first message, as with a client whose messages come in pieces."""


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
        direct: DirectWebSocket = websocket.scope["extensions"][EXTENSION]
        connection = Connection(websocket, direct, service, caller)
        direct.take(connection.take)
        await websocket.accept(subprotocol=wire.SUBPROTOCOL)
        await connection.serve()


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


class _Answer:
    """What is still to be answered of a message, and what is."""

    __slots__ = ("left", "number", "results")

    def __init__(self, number: int, count: int) -> None:
        self.number = number
        self.results: list[bytes | Reply] = [b""] * count
        self.left = count


class Connection:
    """One client's.

    Messages are answered side by side, each when all of its calls are. No more is read while as many calls as are
    allowed are being answered, so that a client that asks without end waits in its own network buffers; nor while
    replies are not read.
    """

    def __init__(self, websocket: WebSocket, direct: DirectWebSocket, service: Service, caller: Caller) -> None:
        self._websocket = websocket
        self._direct = direct
        self._service = service
        self._caller = caller
        self._known_at = service.accounts.changes
        self._calls = Calls(service, caller)
        self._answering = 0
        self._waiting: tuple[int, list[Any]] | None = None
        self._checking = False
        self._queued: Counter[str] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()
        self._over = False
        self._driven, self._streak = "", 0
        self._answered_all = asyncio.Event()

    async def serve(self) -> None:
        """Stay until either side closes; what was begun is brought to its end, so that it can be asked for again."""
        try:
            while (await self._websocket.receive())["type"] != "websocket.disconnect":
                # Binary messages do not come this way.
                await self._refuse(
                    ServiceError(ProblemType.TEXT_MESSAGE, "messages are binary, this one was text", status=400)
                )
        finally:
            self._over = True
            while self._answering:
                self._answered_all.clear()
                await self._answered_all.wait()

    def take(self, data: bytes) -> None:
        """Answer a message."""
        if self._over:
            return
        if self._service.accounts.changes != self._known_at:
            self._checking = True
            self._spawn(self._check_again(data))
        else:
            try:
                number, calls = self._opened(data)
            except ServiceError as error:
                self._over = True
                self._spawn(self._refuse(error))
            else:
                if self._answering and self._answering + len(calls) > wire.CALLS:
                    self._waiting = number, calls
                else:
                    self._begin(number, calls)
        self._pace()

    def _opened(self, data: bytes) -> tuple[int, list[Any]]:
        """Number and calls of a message. Raises ServiceError."""
        limit = self._service.settings.body_limit
        if len(data) > limit:
            raise ServiceError(
                ProblemType.MESSAGE_TOO_LARGE,
                f"the message has {len(data)} bytes, at most {limit} are taken; send fewer calls at a time",
                status=413,
            )
        try:
            return wire.unpack_calls(data)
        except wire.TruncatedMessageError as error:
            raise ServiceError(ProblemType.TRUNCATED_MESSAGE, str(error), status=400) from error
        except wire.MalformedMessageError as error:
            raise ServiceError(ProblemType.MALFORMED_MESSAGE, str(error), status=400) from error

    async def _check_again(self, data: bytes) -> None:
        """As with every request over HTTP: a token that was revoked ends what was begun with it."""
        accounts = self._service.accounts
        changes = accounts.changes
        try:
            caller = await accounts.caller(self._websocket.headers.get("authorization"))
            if caller.id != self._caller.id:
                raise UnauthenticatedError("the token is another agent's by now")
        except Exception as error:
            self._over = True
            await self._refuse(as_service_error(error))
            return
        self._known_at, self._checking = changes, False
        self.take(data)

    def _begin(self, number: int, calls: list[Any]) -> None:
        self._answering += len(calls)
        answer = _Answer(number, len(calls))
        self._look_at(calls)
        for at, call in enumerate(calls):
            done = partial(self._take_result, answer, at)
            about = _about(call)
            # The short way must not overtake what was sent before about the same episode.
            if about in self._queued or not self._calls.begin(call, done):
                self._queued[about] += 1
                self._spawn(self._answer(call, about, done))

    async def _answer(self, call: Any, about: str, done: Callable[[bytes | Reply], None]) -> None:
        # What is told where the service ends before the answer is there.
        result = problem_result(stopping())
        try:
            result = await self._calls.answer(call)
        finally:
            self._queued[about] -= 1
            if not self._queued[about]:
                del self._queued[about]
            done(result)

    def _take_result(self, answer: _Answer, at: int, result: bytes | Reply) -> None:
        answer.results[at] = result
        answer.left -= 1
        if not answer.left:
            pieces: list[bytes | memoryview] = [wire.results_head(answer.number, len(answer.results))]
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
            if self._streak >= _STREAK:
                self._lend()

    def _look_at(self, calls: list[Any]) -> None:
        """Count messages that hold nothing but one step of the same episode."""
        only = calls[0]
        episode = _about(only) if len(calls) == 1 and isinstance(only, list) and only[:1] == [Call.STEP] else ""
        self._streak = self._streak + 1 if episode and episode == self._driven else 0
        self._driven = episode

    def lend(self, recall: Callable[[], None]) -> int | None:
        """Have the connection used by another process."""
        return self._direct.lend(recall)

    def returned(self, came: LoanResult) -> None:
        """Go on where the other process has stopped, or let it go on."""
        self._calls.note(came)
        self._direct.take_back(came.unread, came.unsent, broken=came.broken)
        if came.again:
            self._lend()
        elif came.unread and came.observation is None:
            self._streak = -_IN_VAIN

    def answer(self, last: LastStep) -> Done:
        """Answer the step that ended the other process's episode."""
        self._answering += 1
        self._streak = 0
        return self._calls.stepped(partial(self._take_result, _Answer(last.number, 1), 0), last.seconds)

    def _lend(self) -> None:
        """Let the simulator answer the steps that follow, where that is possible now."""
        if not self._over and self._service.accounts.changes == self._known_at:
            self._calls.lend(self._driven, self)

    def _pace(self) -> None:
        self._direct.set_busy(self._checking or self._waiting is not None or self._answering >= wire.CALLS)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _refuse(self, error: ServiceError) -> None:
        self._over = True
        self._direct.send_message([wire.join_results(None, [problem_result(error)])])
        # Who has left meanwhile does not hear it.
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await self._websocket.close(_CLOSE_CODES.get(error.kind, _FAILED), error.kind.value)


def _about(call: Any) -> str:
    """The episode that a call is about; of an evaluation or a key no harm is done."""
    if isinstance(call, list) and len(call) > 1 and isinstance(call[1], str):
        return call[1]
    return ""
