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

    If the connection breaks, it is opened again and every unanswered message is sent again. Nothing happens twice: a
    step carries its ``seq``, and a call that begins an episode carries a key.
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
        self._unanswered: dict[int, bytes] = {}
        self._connect()

    def close(self) -> None:
        """Close the connection; open episodes stay open."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def submit(self, calls: Sequence[EpisodeCall]) -> int:
        """Send a message of calls and return its number."""
        if not 0 < len(calls) <= CALLS:
            raise ValueError(f"calls: are {len(calls)}; send 1 to {CALLS} in a message")
        with self._alone:
            self._number = number = (self._number + 1) % _NUMBERS
            self._unanswered[number] = message = pack_calls(number, calls)
            try:
                self._connected().send(message)
            except OSError:
                self._connect()
            return number

    def retry_busy(self, calls: Sequence[EpisodeCall], results: list[Result]) -> None:
        """Repeat the calls that met a busy service, and replace their results."""
        if ServiceBusyError not in map(type, results):
            return  # as nearly always, so this check is quick
        begun = False

        def attempt() -> None:
            nonlocal begun
            busy = [at for at, result in enumerate(results) if isinstance(result, ServiceBusyError)]
            if begun:
                again = self._results_of(self.submit([calls[at] for at in busy]))
                for at, result in zip(busy, again, strict=True):
                    results[at] = result
            begun = True
            if refusals := [result for result in results if isinstance(result, ServiceBusyError)]:
                raise max(refusals, key=lambda error: error.retry_after or 0.0)

        with contextlib.suppress(ServiceBusyError):  # the results say so
            self._contact.persist(attempt, self.patience)

    def _receive(self) -> tuple[int, list[Result]]:
        while True:
            try:
                number, results = unpack_results(self._connected().receive())
            except OSError:
                self._connect()
                continue
            except MalformedMessageError as error:
                raise ProtocolError(f"the service's message cannot be read: {error}") from error
            read = [_read(result) for result in results]
            if number is None:  # about the connection itself
                self.close()
                if read and isinstance(read[0], ApiError):
                    raise read[0]
                raise ProtocolError("the service's message has no number")
            # A message that was sent over two connections may be answered twice.
            if self._unanswered.pop(number, None) is not None:
                return number, read

    def _connected(self) -> WebSocketConnection:
        if self._connection is None:
            raise ConnectionBrokeError("the connection is closed")
        return self._connection

    def _connect(self) -> None:
        """Connect, and send unanswered messages again."""
        self.close()

        def attempt() -> WebSocketConnection:
            connection = self._open(offered=self._contact.offers_socket)
            try:
                for message in self._unanswered.values():
                    connection.send(message)
            except BaseException:
                connection.close()
                raise
            return connection

        try:
            self._connection = self._contact.persist(attempt, self.patience)
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
