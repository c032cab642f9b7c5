"""Requests of many connections take turns, and nothing is begun for a client that does not read its replies."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any
from unittest.mock import Mock

from uvicorn import Config
from uvicorn.server import ServerState

from wrongturn_service.socket.guards import Guard, GuardedHttp


class Clients:
    """Connections to an application that notes each request, and in which turn of the event loop it was begun."""

    def __init__(self) -> None:
        self.begun: list[tuple[str, int]] = []
        self._turn = 0
        self._guard = Guard(most=100, patience_s=30.0, closed=lambda reason: None)
        self._config = Config(self._answer, interface="asgi3", log_config=None)
        asyncio.get_running_loop().call_soon(self._count)

    def _count(self) -> None:
        self._turn += 1
        asyncio.get_running_loop().call_soon(self._count)

    async def _answer(
        self, scope: Any, receive: Callable[[], Any], send: Callable[..., Coroutine[Any, Any, None]]
    ) -> None:
        self.begun.append((scope["path"], self._turn))
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
        await send({"type": "http.response.body"})

    def connect(self) -> GuardedHttp:
        connection = GuardedHttp(self._config, ServerState(), {}, guard=self._guard)
        transport = Mock(asyncio.Transport)
        transport.is_closing.return_value = False
        transport.get_write_buffer_size.return_value = 0
        transport.get_extra_info.side_effect = {"socket": Mock(fileno=lambda: 3)}.get
        connection.connection_made(transport)
        return connection

    @property
    def paths(self) -> list[str]:
        return [path for path, _ in self.begun]


def requests(*paths: str) -> bytes:
    return b"".join(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode() for path in paths)


async def turns(count: int = 30) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


async def test_connections_take_turns_however_much_each_asks_for() -> None:
    clients = Clients()
    for name in "abc":
        clients.connect().data_received(requests(*(f"/{name}{number}" for number in range(4))))
    await turns()
    assert clients.paths == [f"/{name}{number}" for number in range(4) for name in "abc"]
    assert len({turn for _, turn in clients.begun}) == 12


async def test_nothing_is_begun_for_a_client_that_does_not_read() -> None:
    clients = Clients()
    idle, other = clients.connect(), clients.connect()
    idle.data_received(requests("/first"))
    await turns()
    idle.pause_writing()
    idle.data_received(requests("/second", "/third"))
    other.data_received(requests("/other"))
    await turns()
    assert clients.paths == ["/first", "/other"]
    idle.resume_writing()
    await turns()
    assert clients.paths == ["/first", "/other", "/second", "/third"]


async def test_nothing_is_begun_for_a_client_that_has_left() -> None:
    clients = Clients()
    one, left = clients.connect(), clients.connect()
    one.data_received(requests("/one"))
    left.data_received(requests("/left"))
    left.transport.is_closing.return_value = True  # type: ignore[attr-defined]
    await turns()
    assert clients.paths == ["/one"]
