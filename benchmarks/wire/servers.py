"""What answers: bare sockets, and the service."""

import contextlib
import multiprocessing
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

from emulation import TRACK, Asked, command, observation, seconds, work

from wrongturn_protocol import wire

IN = 32
"""Bytes of a bare socket's request."""
HOUR = 3600.0


def bare(ready: Any) -> None:
    """A process for each connection, in which the simulation runs: 32 bytes in, a block out."""
    block = wire.block(observation(), TRACK)
    duration = seconds()

    def serve(connection: socket.socket) -> None:
        while connection.recv(IN, socket.MSG_WAITALL):
            work(duration)
            connection.sendall(block)

    _forking(serve, ready)


def hop(ready: Any) -> None:
    """A process for each connection, in front of one of the service's simulator processes."""

    def serve(connection: socket.socket) -> None:
        asked = Asked()
        while connection.recv(IN, socket.MSG_WAITALL):
            asked.ask()
            connection.sendall(asked.answer())

    _forking(serve, ready)


def _forking(serve: Callable[[socket.socket], None], ready: Any) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.create_server(("127.0.0.1", 0), backlog=64) as server:
        ready.send(server.getsockname()[1])
        while True:
            connection, _ = server.accept()
            if os.fork() == 0:
                server.close()
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                serve(connection)
                os._exit(0)
            connection.close()


def service(folder: str, emulated: bool, simulators: int, ready: Any) -> None:
    """The service as it is run; what steps cost it beyond their simulation can be asked of it through the pipe."""
    from wrongturn_service import logs, server, telemetry  # noqa: PLC0415
    from wrongturn_service.address import bind  # noqa: PLC0415
    from wrongturn_service.settings import Settings  # noqa: PLC0415
    from wrongturn_service.simulators.local_simulator import LocalStarter  # noqa: PLC0415

    if emulated:
        LocalStarter.__init__.__kwdefaults__["command"] = command()  # type: ignore[index]
    overheads = _overheads(telemetry.Telemetry)
    settings = Settings(
        port=0,
        database=f"sqlite+aiosqlite:///{folder}/wire-{emulated}.db",
        simulators=simulators,
        spare_simulators=0,
        # A way that is not its turn is silent for long.
        lease_release_s=HOUR,
        lease_abort_s=2 * HOUR,
        ping_interval_s=HOUR,
        max_sockets=256,
    )
    logs.configure("error")
    bound = bind(settings.host, settings.port)
    ready.send(bound.getsockname()[1])
    threading.Thread(target=_tell, args=(overheads, ready), daemon=True).start()
    server.run(settings, bound)


class _Noting:
    """Keeps what is observed, and passes it on."""

    def __init__(self, series: Any, noted: list[float]) -> None:
        self._series, self._noted = series, noted

    def observe(self, value: float) -> None:
        self._noted.append(value)
        self._series.observe(value)


def _overheads(kind: Any) -> list[float]:
    """Every step's seconds beyond its simulation, as they are noted."""
    noted: list[float] = []
    made = kind.__init__

    def make(self: Any) -> None:
        made(self)
        simulation, overhead = self._by_call["step"]
        self._by_call["step"] = (simulation, _Noting(overhead, noted))

    kind.__init__ = make
    return noted


def _tell(overheads: list[float], pipe: Any) -> None:
    with contextlib.suppress(EOFError):
        while pipe.recv():
            taken = overheads[:]
            del overheads[: len(taken)]
            pipe.send(taken)


@contextlib.contextmanager
def started(target: Callable[..., None], *arguments: object) -> Iterator[tuple[int, Any]]:
    """A server in a process of its own: its port, and the pipe to it."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=target, args=(*arguments, there), daemon=False)
    process.start()
    there.close()
    try:
        yield here.recv(), here
    finally:
        here.close()
        process.terminate()
        process.join()
