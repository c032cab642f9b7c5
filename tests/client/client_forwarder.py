"""A forwarder between client and service that can be cut."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from urllib.parse import urlsplit

import httpx

STEPS_OVER_HTTP = 'wrongturn_request_seconds_count{method="POST",route="/v1/episodes/{episode}/step"'


def figure(url: str, name: str) -> float:
    """The sum of the shared service's metrics that begin so."""
    operator = {"Authorization": "Bearer operator-token-of-the-tests-0123456789"}
    lines = httpx.get(url + "/metrics", headers=operator, timeout=60).raise_for_status().text.splitlines()
    return sum(float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith(name))


class Forwarder:
    """What lies between client and service; it can be cut, and counts how often it was plugged in."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._to = (parts.hostname or "", parts.port or 80)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._at = self._listener.getsockname()
        self.url = f"http://127.0.0.1:{self._at[1]}"
        self.plugged = 0
        self.cut_after: int | None = None
        """Bytes from the service after which each connection ends, once."""
        self.kept = threading.Event()
        """Set when something from the client is kept back."""
        self._passing = threading.Event()
        self._passing.set()
        self._stand_in: bytes | None = None
        self._open: list[socket.socket] = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            self.plugged += 1
            if self._stand_in is not None:
                with near, contextlib.suppress(OSError):
                    near.recv(65536)  # closed unread, it would be reset
                    near.sendall(self._stand_in)
                continue
            far = socket.create_connection(self._to)
            self._open += [near, far]
            for one, other, back in ((near, far, False), (far, near, True)):
                threading.Thread(target=self._pass, args=(one, other, back), daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket, back: bool) -> None:
        passed = 0
        try:
            while data := one.recv(65536):
                passed += len(data)
                if back and self.cut_after is not None and passed > self.cut_after:
                    self.cut_after = None
                    break
                if not back and not self._passing.is_set():
                    self.kept.set()
                    self._passing.wait()
                other.sendall(data)
        except OSError:
            pass
        _end(one, other)

    @contextlib.contextmanager
    def keeping(self) -> Iterator[None]:
        """What the client sends inside arrives afterwards."""
        self._passing.clear()
        try:
            yield
        finally:
            self._passing.set()

    def cut(self) -> None:
        _end(*self._open)

    def hang_up(self) -> None:
        """A last word, a ping, and gone: who answers it finds nobody."""
        for near in self._open[::2]:
            near.sendall(b"\x89\x00")
        self.cut()
        for end in self._open:
            end.close()
        self._open.clear()

    def unplug(self) -> None:
        """Whoever comes is refused, as while the service is started again; until :meth:`plug`."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.cut()
        for end in self._open:
            end.close()
        self._open.clear()

    def stand_in(self, answer: bytes) -> None:
        """As a forwarder without its service: whoever comes is heard, gets this, and is closed; until :meth:`plug`."""
        self._stand_in = answer
        self.cut()

    def plug(self) -> None:
        if self._stand_in is not None:
            self._stand_in = None
            return
        self._listener = socket.create_server(self._at)
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self.unplug()


def _end(*ends: socket.socket) -> None:
    for end in ends:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
