"""MCP beside OpenEnv's protocol: tools that begin and drive episodes, as JSON-RPC over ``POST /mcp``.

OpenEnv's ``MCPToolClient`` (in its production mode) and plain MCP clients over HTTP speak it. OpenEnv keeps the names
reset, step and state to itself, so the tools have others.
"""

import json
import secrets
from collections.abc import Awaitable, Callable
from typing import Any, Final

from wrongturn_openenv.messages import ErrorCode, RefusedError, ResetRequest, action_of, refusals
from wrongturn_openenv.session import Service, Session
from wrongturn_protocol import Action

_VERSION: Final = "2025-06-18"
_TOOLS: Final = (
    ("begin_episode", "Begin the next episode and see its first observation.", ResetRequest.model_json_schema()),
    ("drive", "Drive on for 0.1 s and see the next observation.", Action.model_json_schema()),
    ("look_up", "Tell the state of the episode, and its verdict at the end.", {"type": "object", "properties": {}}),
)
InThread = Callable[[Callable[[], Any]], Awaitable[Any]]


class RpcError(Exception):
    """A call of MCP that is refused, with JSON-RPC's code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Mcp:
    """Answers calls of MCP. ``shared`` is the session of calls that name none; ``most`` others exist at a time."""

    def __init__(self, service: Service, shared: Session, most: int, in_thread: InThread) -> None:
        self._service = service
        self._shared = shared
        self._most = most
        self._in_thread = in_thread
        self._sessions: dict[str, Session] = {}

    async def answer(self, call: Any) -> dict[str, Any] | None:
        """Return the reply to a call; None to a notification, which gets none."""
        call = call if isinstance(call, dict) else {}
        if call.get("method") and "id" not in call:
            return None
        reply: dict[str, Any] = {"jsonrpc": "2.0", "id": call.get("id")}
        try:
            params = call.get("params") or {}
            if not isinstance(call.get("method"), str) or not isinstance(params, dict):
                raise RpcError(-32600, "give a call of JSON-RPC 2.0: method, id, and params by name")
            return {**reply, "result": await self._result(call["method"], params)}
        except RpcError as error:
            return {**reply, "error": {"code": error.code, "message": str(error)}}

    async def close(self) -> None:
        """End all sessions but the shared one."""
        while self._sessions:
            await self._in_thread(self._sessions.popitem()[1].close)

    async def _result(self, method: str, params: dict[str, Any]) -> dict[str, Any]:
        name = params.get("session_id")
        match method:
            case "initialize":
                about = {"name": "Wrongturn", "version": "1"}
                return {"protocolVersion": _VERSION, "capabilities": {"tools": {}}, "serverInfo": about}
            case "ping":
                return {}
            case "tools/list":
                keys = ("name", "description", "inputSchema")
                return {"tools": [dict(zip(keys, tool, strict=True)) for tool in _TOOLS]}
            case "openenv/session/create":
                if len(self._sessions) >= self._most:
                    raise RpcError(-32000, f"all {self._most} sessions are taken; close one")
                name = secrets.token_urlsafe(12)
                self._sessions[name] = Session(self._service)
                return {"session_id": name}
            case "openenv/session/close":
                await self._in_thread(self._session(name).close)
                self._sessions.pop(str(name), None)
                return {"closed": True}
            case "tools/call":
                session = self._shared if name is None else self._session(name)
                tool, given = params.get("name"), params.get("arguments") or {}
                try:
                    told = await self._in_thread(lambda: _called(session, tool, given))
                except RefusedError as error:
                    if error.code is ErrorCode.VALIDATION_ERROR:
                        raise RpcError(-32602, str(error)) from None
                    return {"content": [{"type": "text", "text": str(error)}], "isError": True}
                text = json.dumps(told, separators=(",", ":"))
                return {"content": [{"type": "text", "text": text}], "structuredContent": told, "isError": False}
        raise RpcError(-32601, f"there is no method {method!r}; call initialize, tools/list or tools/call")

    def _session(self, name: Any) -> Session:
        if name not in self._sessions:
            raise RpcError(-32602, f"session_id: {name!r} is not known; create one by openenv/session/create")
        return self._sessions[name]


def _called(session: Session, tool: Any, given: Any) -> dict[str, Any]:
    """Return what a tool tells. Raises RefusedError, RpcError."""
    if tool == "begin_episode":
        with refusals():
            asked = ResetRequest.model_validate(given)
        return session.reset(asked).model_dump(mode="json")
    if tool == "drive":
        return session.step(action_of(given)).model_dump(mode="json")
    if tool == "look_up":
        return session.state.model_dump(mode="json")
    raise RpcError(-32602, f"name: there is no tool {tool!r}; there are {', '.join(one for one, _, _ in _TOOLS)}")
