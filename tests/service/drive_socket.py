"""A plain WebSocket to ``/v1/drive``, for tests that look at the messages themselves."""

import contextlib
import time
from typing import Any

from service_harness import Service
from websockets.sync.client import ClientConnection, connect

from wrongturn_protocol import wire

Result = list[Any]


class DriveSocket:
    """One connection of one agent."""

    def __init__(self, service: Service, token: str) -> None:
        self.socket: ClientConnection = connect(
            service.url.replace("http", "ws", 1) + wire.PATH,
            subprotocols=[wire.SUBPROTOCOL],  # type: ignore[list-item]
            additional_headers={"Authorization": f"Bearer {token}"},
            compression=None,
            max_size=None,
            open_timeout=60,
            ping_interval=None,
            proxy=None,
        )
        self._number = 0
        self._open: list[str] = []

    def __enter__(self) -> "DriveSocket":
        return self

    def __exit__(self, *_: object) -> None:
        # Their simulators are for the next test, where the connection is still there.
        with contextlib.suppress(Exception):
            for episode in self._open:
                self.call(["abort", episode])
        self.socket.close()

    def send(self, *calls: Result) -> int:
        self._number += 1
        self.socket.send(wire.pack_calls(self._number, calls))
        return self._number

    def receive(self) -> tuple[int | None, list[Result]]:
        message = self.socket.recv(60)
        assert isinstance(message, bytes)
        number, results = wire.unpack_results(message)
        self._open += [told["id"] for status, told, *_ in results if status == 201]
        return number, results

    def call(self, *calls: Result) -> list[Result]:
        sent = self.send(*calls)
        number, results = self.receive()
        assert number == sent, results
        return results

    def one(self, *call: Any) -> Result:
        """Call, and again as long as simulators are being started, which takes long on a busy machine."""
        deadline = time.monotonic() + 240
        while True:
            (result,) = self.call(list(call))
            starting = result[0] == 503 and "are being started" in result[1]["detail"]
            if not starting or time.monotonic() > deadline:
                return result
