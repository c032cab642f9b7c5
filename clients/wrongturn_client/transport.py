"""HTTP: connections that stay open, calls that are repeated until they are answered, and errors.

A step must cost little beside the service's own work. For a small call over loopback httpx takes 0.57 ms and the
standard library 0.13 ms. So plain HTTP uses the standard library; TLS, proxies, injected transports and forms with
files use httpx.
"""

import http.client
import io
import json
import logging
import random
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from email.message import Message
from pathlib import Path
from typing import Any, Final, TypeVar
from urllib.parse import SplitResult, quote, urlsplit
from urllib.request import getproxies, proxy_bypass

import httpx
import msgpack
from pydantic import ValidationError

from wrongturn_client.errors import (
    ModelFileError,
    ProtocolError,
    ServiceBusyError,
    ServiceUnreachableError,
    TownsNotBuiltError,
    WrongturnError,
    api_error,
)
from wrongturn_protocol import Problem
from wrongturn_protocol.submissions import MODEL

T = TypeVar("T")
Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all episodes, or of sent and of all bytes."""
JSON: Final = "application/json"
MSGPACK: Final = "application/msgpack"
CSV: Final = "text/csv"
_LOG: Final = logging.getLogger("wrongturn_client")
_IDLE: Final = 2.0
"""Seconds after which an idle connection is not used again, because servers close them (uvicorn after 5)."""
_FIRST_CONTACT: Final = 5.0
"""Seconds to wait for a URL that has never answered. It may be mistyped."""
_SHORTEST_PAUSE: Final = 0.1
"""Seconds before the first repetition; the pause doubles each time."""
_LONGEST_GROWN_PAUSE: Final = 5.0
"""Seconds; pauses do not grow beyond this."""
_JITTER: Final = 0.1
"""Seconds of random extra pause, so that workers that lost the same service do not return all at once."""


class ConnectionBrokeError(ConnectionError):
    """A connection broke before the answer was complete; sockets raise other kinds of OSError."""


@dataclass(frozen=True, slots=True)
class Answer:
    """An HTTP answer of any status."""

    status: int
    content: bytes
    headers: Message | Mapping[str, str]

    @property
    def media_type(self) -> str:
        """The media type without its parameters; empty if it is missing."""
        return self.headers.get("content-type", "").partition(";")[0].strip().lower()

    def message(self) -> Any:
        """Return the body as plain values, arrays still encoded; raise ProtocolError if it has another type."""
        packed = self.media_type == MSGPACK
        try:
            return msgpack.unpackb(self.content) if packed else json.loads(self.content)
        except (ValueError, msgpack.UnpackException) as error:
            raise ProtocolError(
                f"the answer has status {self.status} but is not {'msgpack' if packed else 'JSON'}; "
                "is there a Wrongturn service at this URL?"
            ) from error

    def checked(self) -> "Answer":
        """Return the answer if it is not an error; raise ApiError, or ProtocolError for a redirection."""
        if self.status < 300:
            return self
        if self.status < 400:
            raise ProtocolError(f"the service redirects to {self.headers.get('location') or 'nowhere'}; give that URL")
        try:
            problem = Problem.model_validate_json(self.content)
        except ValidationError:
            phrase = httpx.codes.get_reason_phrase(self.status)
            detail = (
                f"{self.status} {phrase}, without a problem's description; is there a Wrongturn service at this URL?"
            )
            problem = Problem(type="about:blank", title=phrase, status=self.status, detail=detail)
        try:
            retry_after = max(0.0, float(self.headers.get("retry-after", "")))
        except ValueError:  # it is missing, or a date
            retry_after = None
        raise api_error(problem, retry_after)


class PlainConnections:
    """Plain HTTP with the standard library; threads may share it."""

    def __init__(self, url: SplitResult, timeout: float) -> None:
        self._host = url.hostname or ""
        self._port = url.port or 80
        self._base = url.path
        self._timeout = timeout
        self._idle: deque[tuple[http.client.HTTPConnection, float]] = deque()

    def exchange(self, method: str, path: str, headers: dict[str, str], content: bytes | None) -> Answer:
        """Send a request and return its answer; raise OSError if none comes."""
        connection = self._take()
        try:
            connection.request(method, self._base + path, content, headers)
            response = connection.getresponse()
            if response.length is None and not response.chunked:
                # Such an answer ends when the connection does, so it may have broken off among its headers.
                raise http.client.IncompleteRead(b"")
            body = response.read()
        except BaseException as error:
            connection.close()  # or the rest of this answer would be read as the next one
            if isinstance(error, http.client.HTTPException):
                raise ConnectionBrokeError(reason_of(error)) from error
            raise
        if not response.will_close:
            self._idle.append((connection, time.monotonic()))
        return Answer(response.status, body, response.headers)

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
        """Send a request and return its answer; raise OSError if none comes."""
        return self._send(method, path, headers, content=content)

    def send_model(
        self, path: str, headers: dict[str, str], fields: Mapping[str, str], model: Path, progress: Progress | None
    ) -> Answer:
        """Post a form and return the answer; raise ModelFileError if the model cannot be read."""
        try:
            with _CountedFile(model, progress) as file:
                files = {MODEL: (model.name, file, "application/octet-stream")}
                return self._send("POST", path, headers, data=fields, files=files)
        except ConnectionBrokeError:
            raise
        except OSError as error:
            raise ModelFileError(f"model: {model} cannot be read: {error.strerror or error}") from error

    def close(self) -> None:
        """Close all connections."""
        self._client.close()

    def _send(self, method: str, path: str, headers: dict[str, str], **body: Any) -> Answer:
        try:
            response = self._client.request(method, path, headers=headers, **body)
        except httpx.TransportError as error:
            raise ConnectionBrokeError(reason_of(error)) from error
        return Answer(response.status_code, response.content, response.headers)


class _CountedFile(io.BufferedReader):
    """File that reports how far it has been read."""

    def __init__(self, path: Path, progress: Progress | None) -> None:
        super().__init__(io.FileIO(path))
        self._size, self._progress = path.stat().st_size, progress

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(size)
        if self._progress is not None:
            self._progress(min(self.tell(), self._size), self._size)
        return content


def reason_of(error: Exception) -> str:
    """Return the text of an error, or its name if it has none."""
    return str(error) or type(error).__name__


def is_proxied(url: SplitResult) -> bool:
    """Tell whether the environment names a proxy for a URL."""
    return url.scheme in getproxies() and not proxy_bypass(url.hostname or "")


def connect(
    url: SplitResult, timeout: float, transport: httpx.BaseTransport | None = None
) -> PlainConnections | HttpxConnections:
    """Return the kind of connections that a URL needs; none is opened yet."""
    if transport is not None or url.scheme != "http" or is_proxied(url):
        return HttpxConnections(url.geturl(), timeout, transport)
    return PlainConnections(url, timeout)


class Contact:
    """What a client and its driving connections know of the service at a URL."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.offers_socket = False
        """Whether the WebSocket for driving was there once."""
        self._has_answered = False
        self._waiting = False

    def answered(self) -> None:
        """Note that the service answered."""
        self._has_answered = True
        if self._waiting:
            self._waiting = False
            _LOG.info("%s answers again", self.url)

    def persist(self, attempt: Callable[[], T], patience: float) -> T:
        """Return what ``attempt`` returns, which is repeated while the connection breaks or the service is busy.

        The pauses between grow, or are those of ``Retry-After``. Once ``patience`` seconds are not enough for the next
        one, the last error is raised.
        """
        begin, pause, broken, told = time.monotonic(), _SHORTEST_PAUSE, 0, False
        while True:
            try:
                return attempt()
            except (OSError, ServiceBusyError) as error:
                lasts = patience if self._has_answered else min(patience, _FIRST_CONTACT)
                if isinstance(error, TownsNotBuiltError) and not told:
                    told = True
                    _LOG.warning("%s", error.problem.detail)
                left = lasts - (time.monotonic() - begin)
                longest = min(_LONGEST_GROWN_PAUSE, lasts / 4)
                asked = error.retry_after if isinstance(error, ServiceBusyError) else None
                goes_on = left > longest + _JITTER if asked is None else asked <= left
                if isinstance(error, OSError):
                    broken += 1
                    self._unanswered(reason_of(error), broken, left if goes_on else None)
                if not goes_on:
                    raise
            time.sleep(min(pause, longest) + random.uniform(0, _JITTER) if asked is None else asked)
            pause *= 2

    def _unanswered(self, reason: str, broken: int, left: float | None) -> None:
        """Log once that the client waits. A single broken connection is not worth a line.

        Before the first answer it logs nothing: the error then comes soon.
        """
        if left is None:
            self._waiting = False
        elif broken > 1 and self._has_answered and not self._waiting:
            self._waiting = True
            _LOG.warning("%s does not answer (%s); trying again for up to %.0f s", self.url, reason, left)


class Transport:
    """Sends calls to one service over connections that stay open.

    After a broken connection, or status 429, 502, 503 or 504, a call is repeated for ``patience`` seconds. Every call
    can be repeated safely: those that create something have an ``Idempotency-Key``, a step has its ``seq``. A URL at
    which nobody has answered yet is given up sooner.
    """

    def __init__(
        self,
        url: str,
        token: str | None,
        *,
        transport: httpx.BaseTransport | None = None,
        timeout: float = 30.0,
        patience: float = 60.0,
    ) -> None:
        """Check the URL (without ``/v1``); the first call connects. Raises WrongturnError."""
        if not isinstance(url, str):
            raise WrongturnError(f"url: is {url!r}; give text, such as http://127.0.0.1:8000")
        self.url = url.rstrip("/")
        self.parts = _split(self.url)
        self.patience = patience
        self.timeout = timeout
        self.injected = transport
        self.contact = Contact(self.url)
        self._connections = connect(self.parts, timeout, transport)
        self._headers = {"User-Agent": "wrongturn-client"}
        if token:
            self._headers["Authorization"] = f"Bearer {token}"

    def close(self) -> None:
        """Close the connections."""
        self._connections.close()

    def call(
        self,
        method: str,
        path: str,
        *,
        body: Any = None,
        media_type: str = JSON,
        key: str | None = None,
        patience: float | None = None,
    ) -> Answer:
        """Send a call until it is answered or the patience (seconds; the client's by default) ends.

        The body holds plain values; the media type is that of the body and of the answer, the key the
        ``Idempotency-Key``.

        Raises:
            ServiceUnreachableError: Nobody answered within the patience.
            ApiError: The service refused.
        """
        headers = self._headers | {"Accept": media_type}
        if key is not None:
            headers["Idempotency-Key"] = key
        content = None
        if body is not None:
            headers["Content-Type"] = media_type
            content = msgpack.packb(body) if media_type == MSGPACK else json.dumps(body, allow_nan=False).encode()
        return self._repeat(lambda: self._connections.exchange(method, path, headers, content), patience)

    def send_model(
        self, path: str, fields: Mapping[str, str], model: Path, progress: Progress | None, key: str
    ) -> Answer:
        """Send a form until it is answered, each time from its start; raises as :meth:`call`, or ModelFileError.

        The model is its last field. It is read while it is sent, so it need not fit into memory.
        """
        headers = self._headers | {"Accept": JSON, "Idempotency-Key": key}
        connections = HttpxConnections(self.url, self.timeout, self.injected)
        try:
            return self._repeat(lambda: connections.send_model(path, headers, fields, model, progress))
        finally:
            if self.injected is None:  # closing would close the caller's transport
                connections.close()

    def _repeat(self, exchange: Callable[[], Answer], patience: float | None = None) -> Answer:
        def attempt() -> Answer:
            answer = exchange()
            self.contact.answered()
            return answer.checked()

        try:
            return self.contact.persist(attempt, self.patience if patience is None else patience)
        except OSError as error:
            raise ServiceUnreachableError(self.url, reason_of(error)) from error


def _split(url: str) -> SplitResult:
    """Return the parts of a service's URL; raise WrongturnError for any other."""
    try:
        parts = urlsplit(url)
        if parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0:
            return parts
    except ValueError:
        pass
    wrong = "is not the URL of a service" if "://" in url else "does not begin with http:// or https://"
    raise WrongturnError(f"url: {url!r} {wrong}; give one such as http://127.0.0.1:8000")


def path_of(*parts: str) -> str:
    """Return a path of quoted parts."""
    return "/" + "/".join(quote(part, safe="@") for part in parts)
