"""Driving over ``WS /v1/drive``: many episodes on one connection, many calls in one message."""

import contextlib
from collections.abc import Sequence
from functools import partial
from typing import Any, Final
from urllib.parse import SplitResult

from pydantic import ValidationError

from wrongturn_client.availability import Availability
from wrongturn_client.connections import ConnectionBrokeError
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result
from wrongturn_client.errors import ApiError, ProtocolError, ServiceBusyError, ServiceUnreachableError
from wrongturn_client.one_thread import OneThread
from wrongturn_client.problems import api_error
from wrongturn_client.transport import attempts
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
        availability: Availability | None = None,
    ) -> None:
        """Connect to the service.

        Args:
            url: The service's URL.
            token: An agent's token.
            timeout: Seconds for each wait for an answer.
            patience: Seconds for which to try again while the service is busy or does not answer; 0 for never.
            availability: What the client knows of the service. By default nothing; the first attempts then end soon.

        Raises:
            ServiceUnreachableError: Nobody answers.
            NotOfferedError: There is no such WebSocket.
            ApiError: The service refuses.
        """
        self.patience = patience
        self._url = url
        self._availability = availability or Availability(url.geturl())
        self._open = partial(WebSocketConnection, url, token, timeout)
        self._connection: WebSocketConnection | None = None
        self._alone = OneThread()
        self._number = 0
        self._unanswered: dict[int, bytes] = {}
        self._early: dict[int, list[Result]] = {}
        """Results that came while another message was waited for."""
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
            except ConnectionBrokeError:
                self._connect()
            return number

    def receive(self) -> tuple[int, list[Result]]:
        """Wait for any answered message and return its number and results."""
        with self._alone:
            if self._early:
                number = next(iter(self._early))
                return number, self._early.pop(number)
            return self._receive()

    def exchange(self, calls: Sequence[EpisodeCall], patience: float | None = None) -> list[Result]:
        """Send a message of calls and return their results; calls that meet a busy service are repeated."""
        with self._alone:
            results = self._wait(self.submit(calls))
            self.retry_busy(calls, results, patience)
            return results

    def retry_busy(self, calls: Sequence[EpisodeCall], results: list[Result], patience: float | None = None) -> None:
        """Repeat the calls that met a busy service, and replace their results."""
        if ServiceBusyError not in map(type, results):
            return  # as nearly always, so this check is quick
        busy = [at for at, result in enumerate(results) if isinstance(result, ServiceBusyError)]
        first = True
        with contextlib.suppress(ServiceBusyError):  # the results say so
            for attempt in attempts(self.patience if patience is None else patience, self._availability):
                with attempt:
                    if not first:
                        again = self._wait(self.submit([calls[at] for at in busy]))
                        for at, result in zip(busy, again, strict=True):
                            results[at] = result
                    first = False
                    refusals = {at: error for at in busy if isinstance(error := results[at], ServiceBusyError)}
                    busy = list(refusals)
                    if busy:
                        raise max(refusals.values(), key=lambda error: error.retry_after or 0.0)

    def _wait(self, wanted: int) -> list[Result]:
        while True:
            number, results = self._receive()
            if number == wanted:
                return results
            self._early[number] = results

    def _receive(self) -> tuple[int, list[Result]]:
        while True:
            try:
                number, results = unpack_results(self._connected().receive())
            except ConnectionBrokeError:
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
        before, self._connection = self._connection, None
        if before is not None:
            before.close()
        try:
            for attempt in attempts(self.patience, self._availability):
                with attempt:
                    connection = self._open(offered=self._availability.offers_socket)
                    try:
                        for message in self._unanswered.values():
                            connection.send(message)
                    except BaseException:
                        connection.close()
                        raise
                    self._connection = connection
                    self._availability.answered()
                    self._availability.offers_socket = True
                    return
        except ConnectionBrokeError as error:
            raise ServiceUnreachableError(self._url.geturl(), str(error)) from error.__cause__


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
