"""A connection over which a test sends what it likes, byte by byte, while a simulator has it."""

import contextlib
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from raw_socket import dial, upgrade
from service_harness import RunningService, metrics
from test_drive_frames import BINARY, PING, PONG, frame

from wrongturn_protocol import wire

Payload = bytes
LOOK = ["look", "ep_none"]


class LentSocket:
    """One connection of one agent; the messages of steps are numbered as the steps are."""

    def __init__(self, service: RunningService, token: str, receive_buffer: int | None = None) -> None:
        self.service = service
        self.raw = dial(service, receive_buffer)
        assert b" 101 " in upgrade(self.raw, token)
        self.raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._come = b""

    def __enter__(self) -> "LentSocket":
        return self

    def __exit__(self, *_: object) -> None:
        self.raw.close()

    def send(self, *calls: list[object], number: int = 0) -> None:
        self.raw.sendall(frame(BINARY, wire.pack_calls(number, calls)))

    def frame(self) -> tuple[int, bytes]:
        """Kind and payload of the next frame. Raises EOFError."""
        first, size = self._take(2)
        if size >= 126:
            size = int.from_bytes(self._take(2 if size == 126 else 8), "big")
        return first & 0x0F, self._take(size)

    def _take(self, count: int) -> bytes:
        while len(self._come) < count:
            piece = self.raw.recv(1 << 18)
            if not piece:
                raise EOFError
            self._come += piece
        taken, self._come = self._come[:count], self._come[count:]
        return taken

    def receive(self) -> Payload:
        """The next message; pings before it are answered."""
        kind, payload = self.frame()
        while kind == PING:
            self.raw.sendall(frame(PONG, payload))
            kind, payload = self.frame()
        assert kind == BINARY, payload
        return payload

    def call(self, *call: object, number: int = 0) -> list[object]:
        self.send(list(call), number=number)
        _, (result,) = wire.unpack_results(self.receive())
        return result

    def step(self, episode: str, seq: int, action: tuple[float, float, float]) -> Payload:
        self.send(["step", episode, seq, *action], number=seq)
        return self.receive()

    def unlent_step(self, episode: str, seq: int, action: tuple[float, float, float]) -> Payload:
        """The same, and nobody takes it for a drive."""
        assert self.call(*LOOK)[0] == 404
        return self.step(episode, seq, action)


def lent(service: RunningService) -> float:
    return figure(service, "wrongturn_sockets_lent")


def figure(service: RunningService, name: str) -> float:
    """One of the service's figures; 0 where there is none of that name yet."""
    lines = metrics(service.url).splitlines()
    return next((float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith(name + " ")), 0.0)


def until(condition: Callable[[], bool], message: str, seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, message
        time.sleep(0.05)


def borrowers(service: RunningService) -> list[int]:
    """Process ids of the simulators that have a connection of the service's."""
    served = _connections(service.process.pid)
    return [pid for pid in service.simulators() if _connections(pid) & served]


def _connections(pid: int) -> set[str]:
    """The connections of a process, by their inodes. A simulator that starts shares other sockets with the service."""
    with contextlib.suppress(FileNotFoundError):
        rows = Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]
        inodes = {f"socket:[{row.split()[9]}]" for row in rows}
        return {target for target in _targets(pid) if target in inodes}
    return set()


def _targets(pid: int) -> Iterator[str]:
    for handle in Path(f"/proc/{pid}/fd").glob("*"):
        with contextlib.suppress(OSError):
            yield handle.readlink().name
