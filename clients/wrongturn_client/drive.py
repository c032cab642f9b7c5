"""Driving over ``WS /v1/drive``: many episodes on one connection, many calls in one message."""

import contextlib
from collections.abc import Sequence
from functools import partial
from typing import Any, Final
from urllib.parse import SplitResult

from pydantic import ValidationError

from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result
from wrongturn_client.errors import ApiError, ProtocolError, ServiceBusyError, ServiceUnreachableError, api_error
from wrongturn_client.transport import ConnectionBrokeError, Contact, reason_of
from wrongturn_client.websocket import WebSocketConnection
from wrongturn_protocol import Problem
from wrongturn_protocol.wire import CALLS, RETRY_AFTER, MalformedMessageError, arrays, pack_calls, unpack_results

_NUMBERS: Final = 2**32


class DriveSocket(DriveConnection):
    """WebSocket connection for driving; one thread may use it at a time. Make it with :meth:`Client.drive`.

    If the connection breaks, it is opened again and a message that has no answer is sent again. Nothing happens twice:
    a step carries its ``seq``, and a call that begins an episode carries a key.
    """

    def __init__(
        self,
        url: SplitResult,
        token: str | None,
        *,
        timeout: float = 30.0,
        patience: float = 60.0,
        contact: Contact | None = None,
    ) -> None:
        """Connect to the service.

        Args:
            url: The service's URL.
            token: An agent's token.
            timeout: Seconds for each wait for an answer.
            patience: Seconds for which to try again while the service is busy or does not answer; 0 for never.
            contact: What the client knows of the service. By default nothing; the first attempts then end soon.

        Raises:
            ServiceUnreachableError: Nobody answers.
            NotOfferedError: There is no such WebSocket.
            ApiError: The service refuses.
        """
        super().__init__(patience)
        self._contact = contact or Contact(url.geturl())
        self._open = partial(WebSocketConnection, url, token, timeout)
        self._connection: WebSocketConnection | None = None
        self._number = 0
        self._connect()

    def close(self) -> None:
        """Close the connection; open episodes stay open."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def exchange(self, calls: Sequence[EpisodeCall]) -> list[Result]:
        """Send a message of calls and return their results; calls that meet a busy service are repeated."""
        if not 0 < len(calls) <= CALLS:
            raise ValueError(f"calls: are {len(calls)}; send 1 to {CALLS} in a message")
        with self._alone:
            results = self._results(calls)
            if ServiceBusyError in map(type, results):
                self._repeat_busy(calls, results)
            return results

    def _results(self, calls: Sequence[EpisodeCall]) -> list[Result]:
        """Send a message until it is answered; if the connection breaks, over another one."""
        self._number = (self._number + 1) % _NUMBERS
        message = pack_calls(self._number, calls)
        while True:
            try:
                if self._connection is None:
                    raise ConnectionBrokeError("the connection is closed")
                self._connection.send(message)
                return self._received(self._connection)
            except OSError:
                self._connect()

    def _received(self, connection: WebSocketConnection) -> list[Result]:
        while True:
            try:
                number, results = unpack_results(connection.receive())
            except MalformedMessageError as error:
                raise ProtocolError(f"the service's message cannot be read: {error}") from error
            if number == self._number:
                return list(map(_read, results))
            if number is None:  # about the connection itself
                self.close()
                why = _read(results[0]) if results else None
                raise why if isinstance(why, ApiError) else ProtocolError("the service's message has no number")

    def _repeat_busy(self, calls: Sequence[EpisodeCall], results: list[Result]) -> None:
        """Repeat the calls that met a busy service, and replace their results."""
        begun = False

        def attempt() -> None:
            nonlocal begun
            busy = [at for at, result in enumerate(results) if isinstance(result, ServiceBusyError)]
            if begun:
                for at, result in zip(busy, self._results([calls[at] for at in busy]), strict=True):
                    results[at] = result
            begun = True
            if refusals := [result for result in results if isinstance(result, ServiceBusyError)]:
                raise max(refusals, key=lambda error: error.retry_after or 0.0)

        with contextlib.suppress(ServiceBusyError):  # the results say so
            self._contact.persist(attempt, self.patience)

    def _connect(self) -> None:
        self.close()
        try:
            self._connection = self._contact.persist(
                lambda: self._open(offered=self._contact.offers_socket), self.patience
            )
        except OSError as error:
            raise ServiceUnreachableError(self._contact.url, reason_of(error)) from error
        self._contact.answered()
        self._contact.offers_socket = True


def _read(result: list[Any]) -> Result:
    status: int = result[0]
    fields: dict[str, Any] = result[1]
    if status >= 300:
        after = fields.pop(RETRY_AFTER, None)
        try:
            return api_error(Problem.model_validate(fields), None if after is None else float(after))
        except ValidationError as error:
            raise ProtocolError(f"the answer has status {status} and no problem that can be read") from error
    if len(result) == 3:
        # The observation of a look belongs to the last reply inside it.
        holder = fields.get("last_reply", fields)
        try:
            holder["observation"] = arrays(result[2])
        except MalformedMessageError as error:
            raise ProtocolError(f"an observation cannot be read: {error}") from error
    return fields
