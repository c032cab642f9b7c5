"""Sending a call until it is answered: headers, retries, msgpack or JSON, and errors."""

import functools
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Final
from urllib.parse import SplitResult, quote, urlsplit

import httpx
import msgpack
import stamina
from pydantic import ValidationError
from stamina import instrumentation

from wrongturn_client.availability import Availability
from wrongturn_client.connections import Answer, ConnectionBrokeError, HttpxConnections, Upload, connect
from wrongturn_client.errors import ProtocolError, ServiceBusyError, ServiceUnreachableError, WrongturnError
from wrongturn_client.problems import api_error
from wrongturn_protocol import Problem

JSON: Final = "application/json"
MSGPACK: Final = "application/msgpack"
CSV: Final = "text/csv"
_SHORTEST_PAUSE: Final = 0.1
"""Seconds before the first repetition; the pause doubles each time."""
_LONGEST_GROWN_PAUSE: Final = 5.0
"""Seconds; pauses do not grow beyond this."""
_JITTER: Final = 0.1
"""Seconds of random extra pause, so that workers that lost the same service do not return all at once."""


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer that is not an error."""

    status: int
    media_type: str
    content: bytes

    def message(self) -> Any:
        """Return the body as plain values, arrays still encoded; raise ProtocolError if it has another type."""
        try:
            if self.media_type == MSGPACK:
                return msgpack.unpackb(self.content)
            return json.loads(self.content)
        except (ValueError, msgpack.UnpackException) as error:
            raise ProtocolError(
                f"the answer has status {self.status} but is not "
                f"{'msgpack' if self.media_type == MSGPACK else 'JSON'}; is there a Wrongturn service at this URL?"
            ) from error


class Transport:
    """Sends calls to one service over connections that stay open.

    After a broken connection, or status 429, 502, 503 or 504, a call is repeated for ``patience`` seconds, with growing
    pauses or after the pause in ``Retry-After``. Every call can be repeated safely: those that create something have an
    ``Idempotency-Key``, a step has its ``seq``. A URL at which nobody has answered yet is given up sooner.
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
        self.patience = patience
        self._timeout, self._injected = timeout, transport
        self._connections = connect(_split(self.url), timeout, transport)
        self._headers = {"User-Agent": "wrongturn-client"}
        if token:
            self._headers["Authorization"] = f"Bearer {token}"
        self.availability = Availability(self.url)

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
        headers: dict[str, str] | None = None,
        patience: float | None = None,
    ) -> Reply:
        """Send a call, whose body and answer have the media type, until it is answered or the patience ends.

        Raises:
            ServiceUnreachableError: Nobody answered within the patience.
            ApiError: The service refused.
        """
        sent = {"Accept": media_type, **(headers or {})}
        content = None
        if body is not None:
            sent["Content-Type"] = media_type
            content = msgpack.packb(body) if media_type == MSGPACK else json.dumps(body, allow_nan=False).encode()
        sent |= self._headers
        return self._repeat(lambda: self._connections.exchange(method, path, sent, content), patience)

    def send_form(self, path: str, upload: Upload, headers: dict[str, str]) -> Reply:
        """Send a form until it is answered, each time from its start; raises as :meth:`call`, or ModelFileError."""
        sent = {"Accept": JSON, **headers, **self._headers}
        connections = HttpxConnections(self.url, self._timeout, self._injected)
        try:
            return self._repeat(lambda: connections.send_form(path, sent, upload))
        finally:
            if self._injected is None:  # closing would close the caller's transport
                connections.close()

    def _repeat(self, exchange: Callable[[], Answer], patience: float | None = None) -> Reply:
        try:
            for attempt in attempts(self.patience if patience is None else patience, self.availability):
                with attempt:
                    answer = exchange()
                    self.availability.answered()
                    return check(answer)
        except ConnectionBrokeError as error:
            raise ServiceUnreachableError(self.url, str(error)) from error.__cause__
        raise AssertionError("stamina ends with a result or an error")


@functools.cache
def _keep_retries_quiet() -> None:
    """Keep stamina from reporting the client's retries, which it does with structlog on stdout.

    The client logs one line itself, see :class:`~wrongturn_client.availability.Availability`. Retries of other programs
    are reported as before.
    """
    instrumentation.set_on_retry_hooks([partial(_report, hook) for hook in instrumentation.get_on_retry_hooks()])


def _report(hook: instrumentation.RetryHook, details: instrumentation.RetryDetails) -> Any:
    ours = isinstance(details.caused_by, ConnectionBrokeError | WrongturnError)
    return None if ours else hook(details)


def attempts(patience: float, availability: Availability) -> Iterator[stamina.Attempt]:
    """Return attempts for ``patience`` seconds, with pauses, at something that fails if a service is away."""
    _keep_retries_quiet()
    begin = time.monotonic()
    longest = min(_LONGEST_GROWN_PAUSE, availability.patience(patience) / 4)
    broken = 0

    def again(error: Exception) -> bool | float:
        """Return whether to try again, or the seconds of pause that the service asked for."""
        nonlocal broken
        if not isinstance(error, ConnectionBrokeError | ServiceBusyError):
            return False
        left = availability.patience(patience) - (time.monotonic() - begin)
        asked = getattr(error, "retry_after", None)
        if asked is not None:
            return float(asked) if asked <= left else False
        more = left > longest + _JITTER
        if isinstance(error, ConnectionBrokeError):
            broken += 1
            if not more:
                availability.given_up()
            elif broken > 1:  # a single broken connection is not worth a line in the log
                availability.unanswered(str(error), left)
        return more

    return iter(
        stamina.retry_context(
            on=again,
            attempts=None,
            timeout=None,
            wait_initial=min(_SHORTEST_PAUSE, longest),
            wait_max=longest,
            wait_jitter=_JITTER,
        )
    )


def check(answer: Answer) -> Reply:
    """Return the answer if it is not an error; raise ApiError, or ProtocolError for a redirection."""
    status = answer.status
    if status < 300:
        return Reply(status, answer.media_type.partition(";")[0].strip().lower(), answer.content)
    if status < 400:
        raise ProtocolError(f"the service redirects to {answer.location or 'nowhere'}; give that URL")
    try:
        problem = Problem.model_validate_json(answer.content)
    except ValidationError:
        phrase = httpx.codes.get_reason_phrase(status)
        problem = Problem(
            type="about:blank",
            title=phrase,
            status=status,
            detail=f"{status} {phrase}, without a problem's description; is there a Wrongturn service at this URL?",
        )
    raise api_error(problem, _seconds(answer.retry_after))


def _seconds(value: str | None) -> float | None:
    """Return ``Retry-After`` in seconds; None if it is missing or a date."""
    try:
        return max(0.0, float(value)) if value is not None else None
    except ValueError:
        return None


def _split(url: str) -> SplitResult:
    """Return the parts of a service's URL; raise WrongturnError for any other."""
    try:
        parts = urlsplit(url)
        if parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0:
            return parts
    except ValueError:
        pass
    if "://" not in url:
        raise WrongturnError(
            f"url: {url!r} does not begin with http:// or https://; give one such as http://127.0.0.1:8000"
        )
    raise WrongturnError(f"url: {url!r} is not the URL of a service; give one such as http://127.0.0.1:8000")


def path_of(*parts: str) -> str:
    """Return a path of quoted parts."""
    return "/" + "/".join(quote(part, safe="@") for part in parts)
