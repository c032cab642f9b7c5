"""HTTP connections to a service that stay open.

A step must cost little beside the service's own work. For a small call over loopback httpx takes 0.57 ms and the
standard library 0.13 ms. So plain HTTP uses the standard library; TLS, proxies, injected transports and forms with
files use httpx.
"""

import http.client
import io
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol
from urllib.parse import SplitResult
from urllib.request import getproxies, proxy_bypass

import httpx

from wrongturn_client.errors import ModelFileError

_IDLE: Final = 2.0
"""Seconds after which an idle connection is not used again, because servers close them (uvicorn after 5)."""


class ConnectionBrokeError(Exception):
    """No connection could be made, or it broke before the answer was complete."""


@dataclass(frozen=True, slots=True)
class Answer:
    """An HTTP answer of any status."""

    status: int
    media_type: str
    location: str | None
    retry_after: str | None
    content: bytes


@dataclass(frozen=True)
class Upload:
    """Form with one file, the last of its fields. The file is read while it is sent, so it need not fit into memory."""

    path: Path
    field: str
    """Name of the file's field."""
    fields: Mapping[str, str]
    """The other fields, which are sent before the file."""
    progress: Callable[[int, int], None] | None = None
    """Called with the numbers of sent and of all bytes of the file."""


class Connections(Protocol):
    """Sends requests over connections that stay open."""

    def exchange(self, method: str, path: str, headers: dict[str, str], content: bytes | None) -> Answer:
        """Send a request and return its answer; raise :class:`ConnectionBrokeError` if none comes."""
        ...

    def close(self) -> None:
        """Close all connections."""


class PlainConnections:
    """Plain HTTP with the standard library; threads may share it."""

    def __init__(self, url: SplitResult, timeout: float) -> None:
        self._host = url.hostname or ""
        self._port = url.port or 80
        self._base = url.path
        self._timeout = timeout
        self._idle: deque[tuple[http.client.HTTPConnection, float]] = deque()

    def exchange(self, method: str, path: str, headers: dict[str, str], content: bytes | None) -> Answer:
        """Send a request and return its answer."""
        connection = self._take()
        try:
            connection.request(method, self._base + path, content, headers)
            response = connection.getresponse()
            if response.length is None and not response.chunked:
                # Such an answer ends when the connection does, so it may have broken off among its headers.
                raise http.client.IncompleteRead(b"")
            body = response.read()
        except (OSError, http.client.HTTPException) as error:
            connection.close()
            raise ConnectionBrokeError(str(error) or type(error).__name__) from error
        except BaseException:  # or the rest of this answer would be read as the next one
            connection.close()
            raise
        if not response.will_close:
            self._idle.append((connection, time.monotonic()))
        header = response.headers.get
        media_type = header("content-type", "")
        return Answer(response.status, media_type, header("location"), header("retry-after"), body)

    def close(self) -> None:
        """Close all connections."""
        while self._idle:
            self._idle.pop()[0].close()

    def _take(self) -> http.client.HTTPConnection:
        try:
            while True:
                connection, since = self._idle.pop()
                if time.monotonic() - since < _IDLE:
                    return connection
                connection.close()
        except IndexError:
            return http.client.HTTPConnection(self._host, self._port, timeout=self._timeout)


class HttpxConnections:
    """TLS, proxies, injected transports and forms with files, with httpx."""

    def __init__(self, url: str, timeout: float, transport: httpx.BaseTransport | None) -> None:
        self._client = httpx.Client(base_url=url, transport=transport, timeout=timeout)

    def exchange(self, method: str, path: str, headers: dict[str, str], content: bytes | None) -> Answer:
        """Send a request and return its answer."""
        return _answer(lambda: self._client.request(method, path, headers=headers, content=content))

    def send_form(self, path: str, headers: dict[str, str], upload: Upload) -> Answer:
        """Post a form and return the answer; raise ModelFileError if its file cannot be read."""
        try:
            with _CountedFile(upload) as file:
                files = {upload.field: (upload.path.name, file, "application/octet-stream")}
                return _answer(lambda: self._client.post(path, headers=headers, data=upload.fields, files=files))
        except OSError as error:
            raise ModelFileError(f"model: {upload.path} cannot be read: {error.strerror or error}") from error

    def close(self) -> None:
        """Close all connections."""
        self._client.close()


class _CountedFile(io.BufferedReader):
    """File that reports how far it has been read."""

    def __init__(self, upload: Upload) -> None:
        super().__init__(io.FileIO(upload.path))
        self._size, self._progress = upload.path.stat().st_size, upload.progress

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(size)
        if self._progress is not None:
            self._progress(min(self.tell(), self._size), self._size)
        return content


def _answer(send: Callable[[], httpx.Response]) -> Answer:
    try:
        response = send()
    except httpx.TransportError as error:
        raise ConnectionBrokeError(str(error) or type(error).__name__) from error
    header = response.headers.get
    media_type = header("content-type", "")
    return Answer(response.status_code, media_type, header("location"), header("retry-after"), response.content)


def connect(url: SplitResult, timeout: float, transport: httpx.BaseTransport | None = None) -> Connections:
    """Return the kind of connections that a URL needs; none is opened yet."""
    proxied = url.scheme in getproxies() and not proxy_bypass(url.hostname or "")
    if transport is not None or proxied or url.scheme != "http":
        return HttpxConnections(url.geturl(), timeout, transport)
    return PlainConnections(url, timeout)
