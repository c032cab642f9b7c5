"""From a call to its answer: headers, retries, msgpack or JSON, and problems turned into errors."""

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import SplitResult, quote, urlsplit

import httpx
import msgpack
import stamina
from pydantic import ValidationError

from wrongturn_client.availability import Availability
from wrongturn_client.connections import Answer, ConnectionBrokeError, connect
from wrongturn_client.errors import (
    ProtocolError,
    ServiceBusyError,
    ServiceUnreachableError,
    WrongturnError,
)
from wrongturn_client.problems import api_error
from wrongturn_protocol import Problem

JSON: Final = "application/json"
MSGPACK: Final = "application/msgpack"
_SHORTEST_PAUSE: Final = 0.1
"""Seconds before the first repetition; doubles with each."""
_LONGEST_GROWN_PAUSE: Final = 5.0
"""Seconds; pauses grow no longer than this."""
_JITTER: Final = 0.1
"""Seconds, drawn on top of a pause, lest workers that lost the same service come back as one."""


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer that is no error."""

    status: int
    media_type: str
    content: bytes

    def message(self) -> Any:
        """The body as plain values, arrays still as they went over the wire.

        Raises:
            ProtocolError: it is neither JSON nor msgpack.
        """
        try:
            if self.media_type == MSGPACK:
                return msgpack.unpackb(self.content)
            return json.loads(self.content)
        except (ValueError, msgpack.UnpackException) as error:
            raise ProtocolError(
                f"the answer is no {'msgpack' if self.media_type == MSGPACK else 'JSON'}, though status "
                f"{self.status} says that all is well; is there a Wrongturn service at this URL?",
            ) from error


class Transport:
    """Sends calls to one service over connections that stay open.

    A call that meets a broken connection, or 429, 502, 503, 504, is sent again for ``patience`` seconds, with growing
    pauses or after the pause that ``Retry-After`` asks for. All calls of the interface bear a repetition: those that
    create carry an ``Idempotency-Key``, a step its ``seq``. A URL at which nobody has answered yet is given up sooner.
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
        """Open nothing yet.

        Args:
            url: of the service, without ``/v1``.
            token: the bearer token; None for public calls alone.
            transport: injected by tests.
            timeout: seconds for each attempt at a call.
            patience: seconds for which a call is repeated; 0 for never.

        Raises:
            WrongturnError: the URL is none.
        """
        self.url = url.rstrip("/")
        self.patience = patience
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
        """Send a call until it is answered.

        Args:
            method: of HTTP.
            path: below the service's URL, with its query.
            body: plain values, or None for none.
            media_type: of the body and of the answer that is asked for.
            headers: beside these.
            patience: seconds for which this call is repeated; the transport's own by default.

        Raises:
            ServiceUnreachableError: nobody answered for as long as the patience lasts.
            ApiError: the service refused.
        """
        sent = {"Accept": media_type, **(headers or {})}
        content = None
        if body is not None:
            sent["Content-Type"] = media_type
            content = msgpack.packb(body) if media_type == MSGPACK else json.dumps(body, allow_nan=False).encode()
        try:
            for attempt in attempts(self.patience if patience is None else patience, self.availability):
                with attempt:
                    return self._once(method, path, sent, content)
        except ConnectionBrokeError as error:
            raise ServiceUnreachableError(self.url, str(error)) from error.__cause__
        raise AssertionError("stamina ends with a result or an error")

    def _once(self, method: str, path: str, headers: dict[str, str], content: bytes | None) -> Reply:
        answer = self._connections.exchange(method, path, self._headers | headers, content)
        self.availability.answered()
        return check(answer)


def attempts(patience: float, availability: Availability) -> Iterator[stamina.Attempt]:
    """Attempts at something that a broken connection or a busy service may stop, with pauses between them.

    Args:
        patience: seconds from now on.
        availability: what is known of the service.
    """
    begin = time.monotonic()
    longest = min(_LONGEST_GROWN_PAUSE, availability.patience(patience) / 4)
    broken = 0

    def again(error: Exception) -> bool | float:
        """Whether to try again; a number is the pause that the service asked for, seconds."""
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
            elif broken > 1:  # one that broke and is there again is not worth a line
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
    """The answer, where it is no error.

    Raises:
        ApiError: it is one.
        ProtocolError: it is a redirection.
    """
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
    """``Retry-After`` in seconds; None where there is none, or where it is a date."""
    try:
        return max(0.0, float(value)) if value is not None else None
    except ValueError:
        return None


def _split(url: str) -> SplitResult:
    """The parts of a service's URL.

    Raises:
        WrongturnError: it is none.
    """
    try:
        parts = urlsplit(url)
        if parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0:
            return parts
    except ValueError:
        pass
    raise WrongturnError(f"url: {url!r} is no URL of a service; give one such as http://127.0.0.1:8000")


def path_of(*parts: str) -> str:
    """A path of parts, each quoted."""
    return "/" + "/".join(quote(part, safe="@") for part in parts)
