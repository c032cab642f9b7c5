"""The calls of an OpenEnv server: ``/ws`` for sessions; ``/reset``, ``/step`` and ``/state`` to try it with curl."""

import asyncio
import contextlib
import json
import threading
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from functools import partial
from importlib.metadata import version
from typing import Any, Final, TypeVar

from fastapi import FastAPI, HTTPException, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import JSONResponse

from wrongturn_openenv.mcp import Mcp
from wrongturn_openenv.messages import (
    ErrorCode,
    RefusedError,
    Reply,
    ResetRequest,
    State,
    StepRequest,
    action_of,
    read,
    refusals,
)
from wrongturn_openenv.session import Service, Session
from wrongturn_protocol import Action, Track
from wrongturn_protocol.observations import json_schema

T = TypeVar("T")
STOP_S: Final = 0.5
"""Seconds that calls have left at a stop, and then the ends of episodes."""
_TRY_AGAIN: Final = 1013
"""The WebSocket's code for a server that is full."""
_DESCRIPTION: Final = "Drive towns whose navigation command may be wrong: steer, throttle and brake, 10 times a second."
_STATUSES: Final = {ErrorCode.VALIDATION_ERROR: 422, ErrorCode.EXECUTION_ERROR: 409}


class OpenEnvServer:
    """Practice sessions on a service.

    Args:
        service: The service.
        sessions: Most sessions at a time.
    """

    def __init__(self, service: Service, sessions: int) -> None:
        self.service = service
        self._most = sessions
        self._open: set[Session] = set()
        self._by_http = Session(service)
        self._http = asyncio.Lock()
        self._calls: set[asyncio.Future[Any]] = set()
        self._stopped = False
        self.mcp = Mcp(service, self._by_http, sessions, self.in_thread)

    async def in_thread(self, function: Callable[[], T]) -> T:
        """Run a function that waits for the service in a thread; raise RefusedError if the server stops meanwhile."""
        stops = RefusedError(ErrorCode.EXECUTION_ERROR, "the server stops")
        if self._stopped:
            raise stops
        call = _in_thread(function)
        self._calls.add(call)
        try:
            return await call
        except asyncio.CancelledError:
            raise stops from None
        finally:
            self._calls.discard(call)

    async def ready(self) -> bool:
        """Return whether the service can take episodes."""
        with contextlib.suppress(RefusedError):
            return await self.in_thread(self.service.ready)
        return False

    async def by_http(self, function: Callable[[Session], T]) -> T:
        """Run a function on the session that all HTTP calls share, and return its result."""
        async with self._http:
            try:
                return await self.in_thread(lambda: function(self._by_http))
            except RefusedError as error:
                raise HTTPException(_STATUSES[error.code], str(error)) from None

    async def converse(self, websocket: WebSocket) -> None:
        """Answer one client until it leaves."""
        await websocket.accept()
        if len(self._open) >= self._most:
            full = RefusedError(
                ErrorCode.CAPACITY_REACHED,
                f"all {self._most} sessions are taken; close one, or start the server with more (--sessions)",
            )
            await websocket.send_text(_error(full))
            await websocket.close(_TRY_AGAIN)
            return
        session = Session(self.service)
        self._open.add(session)
        try:
            while (text := await _received(websocket)) is not None:
                answer = await self.in_thread(partial(_answer, session, text))
                if answer is None:
                    await websocket.close()
                    break
                await websocket.send_text(answer)
        except (WebSocketDisconnect, RefusedError, asyncio.CancelledError):
            pass  # the client is gone, or the server stops
        finally:
            self._open.discard(session)
            await _end(session)

    def stop(self) -> None:
        """Refuse the calls that wait for the service, and all further ones."""
        self._stopped = True
        for call in self._calls:
            call.cancel()

    async def close(self) -> None:
        """End the sessions of HTTP calls and of MCP. The others end with their connections."""
        with contextlib.suppress(RefusedError):
            await self.mcp.close()
        await _end(self._by_http)


def create_app(service: Service, sessions: int) -> FastAPI:
    """Return the ASGI application of an OpenEnv server. Call ``app.state.stop`` before you wait for its tasks."""
    server = OpenEnvServer(service, sessions)

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
        await server.close()

    app = FastAPI(
        title="Wrongturn for OpenEnv",
        version="1.0.0",  # of OpenEnv's standard for HTTP, which its validator reads here
        description=_DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
    )
    app.state.stop = server.stop
    app.websocket("/ws")(server.converse)

    @app.get("/health")
    async def health() -> JSONResponse:
        """Return whether the service can take episodes."""
        ready = await server.ready()
        return JSONResponse({"status": "healthy" if ready else "unhealthy"}, 200 if ready else 503)

    @app.get("/metadata")
    async def metadata() -> dict[str, str]:
        """Describe the environment."""
        return {"name": "Wrongturn", "description": _DESCRIPTION, "version": version("wrongturn-openenv")}

    @app.get("/schema")
    async def schema() -> dict[str, Any]:
        """Return the JSON Schemas of action, observation and state."""
        track = Track(service.defaults.get("track") or Track.STATE)
        return {
            "action": Action.model_json_schema(),
            "observation": json_schema(track),
            "state": State.model_json_schema(),
        }

    @app.post("/reset")
    async def reset(request: ResetRequest | None = None) -> Reply:
        """Begin an episode in the session that all HTTP calls share."""
        return await server.by_http(lambda session: session.reset(request or ResetRequest()))

    @app.post("/step")
    async def step(request: StepRequest) -> Reply:
        """Drive that episode on for 0.1 s."""
        return await server.by_http(lambda session: session.step(action_of(request.action)))

    @app.get("/state")
    async def state() -> State:
        """Return the state of that episode."""
        return await server.by_http(lambda session: session.state)

    @app.post("/mcp", response_model=None)
    async def mcp(request: Request) -> Response:
        """Answer a call of MCP: its tools begin and drive episodes."""
        try:
            call = await request.json()
        except ValueError:
            call = None
        answer = await server.mcp.answer(call)
        return Response(status_code=202) if answer is None else JSONResponse(answer)

    return app


def _in_thread(function: Callable[[], T]) -> asyncio.Future[T]:
    """Run a function in a thread of its own, and return its result to come.

    The thread is a daemon, so that the process can end while it still waits for the service.
    """
    result: Future[T] = Future()
    result.set_running_or_notify_cancel()  # cancelling then only ends the waiting

    def run() -> None:
        try:
            result.set_result(function())
        except BaseException as error:
            result.set_exception(error)

    threading.Thread(target=run, daemon=True, name="session").start()
    return asyncio.wrap_future(result)


async def _end(session: Session) -> None:
    """Close a session. A service that does not answer, or a call under way, does not hold this up for long."""
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(_in_thread(session.close), STOP_S)


async def _received(websocket: WebSocket) -> str | None:
    """Return the text of a client's next message, empty for a binary one; None once the client is gone."""
    message = await websocket.receive()
    return None if message["type"] == "websocket.disconnect" else message.get("text") or ""


def _answer(session: Session, text: str) -> str | None:
    """Do what a message asks for and return the answer's text; None if it asks to close."""
    try:
        message = read(text)
        reply: Reply | State
        if message.type == "close":
            return None
        if message.type == "state":
            reply = session.state
        elif message.type == "step":
            reply = session.step(action_of(message.data))
        else:
            with refusals():
                asked = ResetRequest.model_validate(message.data)
            reply = session.reset(asked)
    except RefusedError as error:
        return _error(error)
    kind = "state" if message.type == "state" else "observation"
    return json.dumps({"type": kind, "data": reply.model_dump(mode="json")}, separators=(",", ":"))


def _error(error: RefusedError) -> str:
    return json.dumps({"type": "error", "data": {"message": str(error), "code": error.code}})
