"""Ways to take a step, each a call without arguments."""

import socket
import struct
from typing import Any

from emulation import SIZE, TRACK, Asked
from servers import IN
from websockets.sync.client import connect

from wrongturn_client import Action, Client
from wrongturn_protocol import PracticeRequest, wire

GAS = Action(steer=0.0, throttle=0.5, brake=0.0)
REQUEST = PracticeRequest(town="junctions", approach="J1-E", track=TRACK)


class Socket:
    """A bare one."""

    def __init__(self, port: int) -> None:
        self.connection = _connected("127.0.0.1", port)
        self.memory = memoryview(bytearray(SIZE))

    def __call__(self) -> None:
        self.connection.sendall(bytes(IN))
        exactly(self.connection, self.memory)


class Episode:
    """One of the service's, which several ways drive by turns."""

    def __init__(self, client: Client) -> None:
        self.id = client.practise(REQUEST).id
        self.seq = 0


class Raw:
    """Our WebSocket with frames written and read by hand: the server alone."""

    def __init__(self, url: str, token: str, episode: Episode) -> None:
        with connect(
            url.replace("http", "ws", 1) + wire.PATH,
            subprotocols=[wire.SUBPROTOCOL],  # type: ignore[list-item]
            additional_headers={"Authorization": f"Bearer {token}"},
            compression=None,
            proxy=None,
        ) as handshake:
            request = handshake.request
            assert request is not None
            lines = f"GET {request.path} HTTP/1.1\r\n{request.headers}"
        host, _, port = url.removeprefix("http://").partition(":")
        self.connection = _connected(host, int(port))
        self.connection.sendall(lines.encode())
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += self.connection.recv(1)
        self.episode = episode
        self.memory = memoryview(bytearray(2 * SIZE))

    def __call__(self) -> None:
        self.episode.seq += 1
        call = wire.pack_calls(1, [["step", self.episode.id, self.episode.seq, 0.0, 0.5, 0.0]])
        self.connection.sendall(struct.pack("!BBI", 0x82, 0x80 | len(call), 0) + call)
        # The head of a frame of 126 to 65,535 bytes, and what follows it, in as few calls as a bare socket makes.
        got = 0
        while got < 4:
            got += _more(self.connection, self.memory[got:])
        kind, length = self.memory[0], int.from_bytes(self.memory[2:4], "big")
        assert (kind, self.memory[1]) == (0x82, 126), bytes(self.memory[:got])
        exactly(self.connection, self.memory[got : 4 + length])
        assert length > SIZE, bytes(self.memory[4 : 4 + length])


class Ours:
    """``Client.drive`` with one episode."""

    def __init__(self, client: Client, episode: Episode) -> None:
        self.drive = client.drive()
        self.episode = episode

    def __call__(self) -> None:
        self.episode.seq += 1
        self.drive.step(self.episode.id, self.episode.seq, GAS)


class Http:
    """``Client.step``."""

    def __init__(self, client: Client, episode: Episode) -> None:
        self.client = client
        self.episode = episode

    def __call__(self) -> None:
        self.episode.seq += 1
        self.client.step(self.episode.id, self.episode.seq, GAS)


class Batch:
    """``Client.drive`` with so many episodes in a message."""

    def __init__(self, client: Client, count: int, request: PracticeRequest = REQUEST) -> None:
        self.drive = client.drive()
        self.request = request
        self.names = [self.drive.practise(request).id for _ in range(count)]
        self.seqs = [0] * count

    def __call__(self) -> None:
        self.seqs = [seq + 1 for seq in self.seqs]
        steps = [(name, seq, GAS) for name, seq in zip(self.names, self.seqs, strict=True)]
        for at, reply in enumerate(self.drive.steps(steps)):
            if isinstance(reply, Exception):
                raise reply
            if reply.terminated or reply.truncated:
                self.names[at], self.seqs[at] = self.drive.practise(self.request).id, 0


class InProcess:
    """As many emulated simulations in this process, one after the other, each observation copied into one array."""

    def __init__(self, count: int) -> None:
        from emulation import Emulated  # noqa: PLC0415

        self.episodes = [Emulated() for _ in range(count)]
        self.blocks = [wire.Block(memory, TRACK) for memory in _split(bytearray(count * SIZE), count)]

    def __call__(self) -> None:
        for episode, block in zip(self.episodes, self.blocks, strict=True):
            block.write(episode.step(0.0, 0.5, 0.0)[0])


class Workers:
    """As many of the service's simulator processes, asked by this one with nothing between: each block copied."""

    def __init__(self, count: int) -> None:
        self.simulators = [Asked() for _ in range(count)]
        self.memory = list(_split(bytearray(count * SIZE), count))

    def __call__(self) -> None:
        for simulator in self.simulators:
            simulator.ask()
        for simulator, memory in zip(self.simulators, self.memory, strict=True):
            memory[:] = simulator.answer()


def _split(memory: bytearray, count: int) -> Any:
    view = memoryview(memory)
    return (view[at * SIZE : (at + 1) * SIZE] for at in range(count))


def _connected(host: str, port: int) -> socket.socket:
    connection = socket.create_connection((host, port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _more(connection: socket.socket, memory: memoryview) -> int:
    got = connection.recv_into(memory)
    if not got:
        raise EOFError("the server has closed the connection")
    return got


def exactly(connection: socket.socket, memory: memoryview) -> None:
    """Fill the memory."""
    got = 0
    while got < len(memory):
        got += _more(connection, memory[got:])
