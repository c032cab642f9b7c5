"""Steps a second over the wire: a bare socket, our WebSocket with a raw and with our own client, and HTTP, interleaved.

``python benchmarks/wire.py [--steps N] [--rounds N] [--work MICROSECONDS] [--json FILE]``

Simulators are emulated: a process that works for so long and gives an observation of the track ``segmentation``. The
bare socket serves the same observation from one process that works as long, 32 bytes in and the block out: what no
protocol can beat. ``with a hop`` asks such a process through another one, as the service has to.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import socket
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from wrongturn_client import Action, Client
from wrongturn_protocol import PracticeRequest, Track, wire
from wrongturn_protocol.observations import observation_space

TRACK = Track.SEGMENTATION
GAS = Action(steer=0.0, throttle=0.5, brake=0.0)
REQUEST = PracticeRequest(town="junctions", approach="J1-E", track=TRACK)
WORK = "WRONGTURN_BENCHMARK_WORK_S"


def work(seconds: float) -> None:
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def observation() -> dict[str, Any]:
    space = observation_space(TRACK)
    space.seed(0)
    sample: dict[str, Any] = space.sample()
    return sample


def bare(seconds: float, ready: Any) -> None:
    """One connection after the other: 32 bytes in, a block out."""
    block = wire.block(observation(), TRACK)
    with socket.create_server(("127.0.0.1", 0)) as server:
        ready.send(server.getsockname()[1])
        while True:
            connection, _ = server.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection:
                while connection.recv(32, socket.MSG_WAITALL):
                    work(seconds)
                    connection.sendall(block)


def relay(port: int, ready: Any) -> None:
    """The same with one more hop between processes."""
    size = wire.layout(TRACK).size
    with socket.create_server(("127.0.0.1", 0)) as server:
        ready.send(server.getsockname()[1])
        while True:
            connection, _ = server.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection, socket.create_connection(("127.0.0.1", port)) as far:
                while call := connection.recv(32, socket.MSG_WAITALL):
                    far.sendall(call)
                    connection.sendall(exactly(far, size))


def exactly(connection: socket.socket, size: int) -> memoryview:
    data = memoryview(bytearray(size))
    got = 0
    while got < size:
        got += connection.recv_into(data[got:])
    return data


def simulator() -> None:
    """The service's simulator process with an emulated simulation."""
    from wrongturn_service.pool import process  # noqa: PLC0415

    shown = observation()
    seconds = float(os.environ[WORK])

    class Emulated:
        def __init__(self, *_: object) -> None:
            self.steps = 0

        def reset(self) -> Any:
            return shown

        def step(self, *_: float) -> Any:
            work(seconds)
            return shown, 1.0, False, False

    process.Episode = Emulated  # type: ignore[misc, assignment]
    process.Server.warm_up = lambda _: None  # type: ignore[method-assign]
    process.main()


def service(database: str, ready: Any) -> None:
    from wrongturn_service import logs, server  # noqa: PLC0415
    from wrongturn_service.address import bind  # noqa: PLC0415
    from wrongturn_service.pool import local  # noqa: PLC0415
    from wrongturn_service.settings import Settings  # noqa: PLC0415

    command = (sys.executable, __file__, "--simulator")
    local.LocalPool.__init__.__kwdefaults__["command"] = command  # type: ignore[index]
    settings = Settings(port=0, database=f"sqlite+aiosqlite:///{database}", simulators=32)
    logs.configure("error")
    bound = bind(settings.host, settings.port)
    ready.send(bound.getsockname()[1])
    server.run(settings, bound)


@contextlib.contextmanager
def started(target: Callable[..., None], *arguments: object) -> Iterator[int]:
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=target, args=(*arguments, there), daemon=False)
    process.start()
    yield here.recv()
    process.terminate()
    process.join()


def rate(step: Callable[[], None], steps: int, each: int = 1) -> float:
    for _ in range(max(1, steps // 10)):
        step()
    begin = time.perf_counter()
    for _ in range(steps):
        step()
    return steps * each / (time.perf_counter() - begin)


class Socket:
    """A bare one."""

    def __init__(self, port: int) -> None:
        self.connection = socket.create_connection(("127.0.0.1", port))
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.size = wire.layout(TRACK).size

    def __call__(self) -> None:
        self.connection.sendall(bytes(32))
        exactly(self.connection, self.size)


class Raw:
    """Our WebSocket with frames written and read by hand: the server alone."""

    def __init__(self, url: str, token: str, episode: str) -> None:
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
        self.connection = socket.create_connection((host, int(port)))
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.connection.sendall(lines.encode())
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += self.connection.recv(1)
        self.episode, self.seq = episode, 0

    def __call__(self) -> None:
        self.seq += 1
        call = wire.pack_calls(1, [["step", self.episode, self.seq, 0.0, 0.5, 0.0]])
        self.connection.sendall(struct.pack("!BBI", 0x82, 0x80 | len(call), 0) + call)
        while True:
            kind, length = exactly(self.connection, 2)
            if length == 126:
                (length,) = struct.unpack("!H", exactly(self.connection, 2))
            elif length == 127:
                (length,) = struct.unpack("!Q", exactly(self.connection, 8))
            exactly(self.connection, length)
            if kind == 0x82:
                return


class Ours:
    """``Client.drive`` with so many episodes in a message."""

    def __init__(self, client: Client, episodes: int = 1) -> None:
        self.drive = client.drive()
        self.names = [self.drive.practise(REQUEST).id for _ in range(episodes)]
        self.seq = 0

    def __call__(self) -> None:
        self.seq += 1
        if len(self.names) == 1:
            self.drive.step(self.names[0], self.seq, GAS)
            return
        for reply in self.drive.steps([(name, self.seq, GAS) for name in self.names]):
            assert not isinstance(reply, Exception), reply


class Http:
    def __init__(self, client: Client) -> None:
        self.client, self.seq = client, 0
        self.episode = client.practise(REQUEST).id

    def __call__(self) -> None:
        self.seq += 1
        self.client.step(self.episode, self.seq, GAS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--work", type=float, default=145.0, help="microseconds of an emulated step")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--profile", action="store_true", help="of our client")
    given = parser.parse_args()
    seconds = given.work * 1e-6
    os.environ[WORK] = str(seconds)
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        os.environ.setdefault("WRONGTURN_HOME", folder)
        port = stack.enter_context(started(bare, seconds))
        hop = stack.enter_context(started(relay, port))
        second = stack.enter_context(started(bare, seconds))
        url = f"http://127.0.0.1:{stack.enter_context(started(service, str(Path(folder) / 'wire.db')))}"
        with Client(url) as anybody:
            anybody.ready()
            token = anybody.register("wire", TRACK).token
        client = stack.enter_context(Client(url, token))
        ways: dict[str, tuple[Callable[[], None], int]] = {
            "bare socket": (Socket(second), 1),
            "bare socket with a hop": (Socket(hop), 1),
            "WebSocket, raw client": (Raw(url, token, client.practise(REQUEST).id), 1),
            "WebSocket, our client": (Ours(client), 1),
            "WebSocket, our client, batches of 16": (Ours(client, 16), 16),
            "HTTP, our client": (Http(client), 1),
        }
        rates: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(given.rounds):
            for name, (step, each) in ways.items():
                rates[name].append(rate(step, given.steps // each, each))
        if given.profile:
            import cProfile  # noqa: PLC0415

            step = ways["WebSocket, our client"][0]
            cProfile.runctx("rate(step, 2000)", globals(), {"step": step}, sort="tottime")
    medians = {name: statistics.median(values) for name, values in rates.items()}
    for name, value in medians.items():
        print(f"{name:40} {value:8.0f} steps/s   {value / medians['bare socket with a hop']:.2f} of the one with a hop")
    if given.json:
        given.json.write_text(json.dumps({"block": wire.layout(TRACK).size, "steps_per_second": rates}, indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--simulator"]:
        del sys.argv[1]
        simulator()
    else:
        main()
