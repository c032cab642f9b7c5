"""Driving over ``WS /v1/drive``: many episodes on one connection, many calls in one message."""

import contextlib
import socket
from collections.abc import Sequence
from functools import partial
from typing import Any, Final, NoReturn
from urllib.parse import SplitResult

from pydantic import ValidationError
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage, InvalidStatus
from websockets.http11 import Response
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result
from wrongturn_client.errors import (
    ApiError,
    NotOfferedError,
    ProtocolError,
    ServiceBusyError,
    ServiceUnreachableError,
    api_error,
)
from wrongturn_client.transport import Answer, ConnectionBrokeError, Contact, reason_of
from wrongturn_protocol import Problem, ProblemType
from wrongturn_protocol.wire import (
    CALLS,
    PATH,
    RETRY_AFTER,
    SUBPROTOCOL,
    MalformedMessageError,
    arrays,
    pack_calls,
    unpack_results,
)

_NUMBERS: Final = 2**32
_CLOSE_TIMEOUT: Final = 1.0
_BUSY: Final = frozenset({429, 502, 503, 504})
_ANSWERS: Final = _BUSY | {401}
"""Refusals that do not tell whether there is such a WebSocket."""


class DriveSocket(DriveConnection):
    """WebSocket connection for driving; one thread may use it at a time. Make it with :meth:`Client.drive`.

    If the connection breaks, it is opened again and a message that has no answer is sent again. Nothing happens twice:
    a step carries its ``seq``, and a call that begins an episode carries a key.
    """

    def __init__(
        self, url: SplitResult, token: str | None, *, timeout: float, patience: float, contact: Contact
    ) -> None:
        """Connect with an agent's token; ``timeout`` and ``patience`` are those of :class:`~wrongturn_client.Client`.

        Raises:
            ServiceUnreachableError: Nobody answers.
            NotOfferedError: There is no such WebSocket.
            ApiError: The service refuses.
        """
        super().__init__(patience)
        self._contact = contact
        self._dial = partial(_dialled, url, token, timeout)
        self._timeout = timeout
        self._connection: ClientConnection | None = None
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
        results: dict[int, Result] = {}

        def attempt() -> None:
            left = [at for at in range(len(calls)) if isinstance(results.get(at), ServiceBusyError | None)]
            results.update(zip(left, self._results([calls[at] for at in left]), strict=True))
            if busy := [result for result in results.values() if isinstance(result, ServiceBusyError)]:
                raise max(busy, key=lambda error: error.retry_after or 0.0)

        with self._alone, contextlib.suppress(ServiceBusyError):  # the results say so
            self._contact.persist(attempt, self.patience)
        return [results[at] for at in range(len(calls))]

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
            except (OSError, ConnectionClosed):
                self._connect()

    def _received(self, connection: ClientConnection) -> list[Result]:
        while True:
            try:
                number, results = unpack_results(connection.recv(self._timeout, decode=False))
            except MalformedMessageError as error:
                raise ProtocolError(f"the service's message cannot be read: {error}") from error
            if number == self._number:
                return list(map(_read, results))
            if number is None:  # about the connection itself
                self.close()
                why = _read(results[0]) if results else None
                raise why if isinstance(why, ApiError) else ProtocolError("the service's message has no number")

    def _connect(self) -> None:
        self.close()
        try:
            self._connection = self._contact.persist(
                lambda: self._dial(offered=self._contact.offers_socket), self.patience
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


def _dialled(url: SplitResult, token: str | None, timeout: float, *, offered: bool) -> ClientConnection:
    """Connect and shake hands; raise OSError if nobody answers.

    ``offered``: the WebSocket was there before. Any other answer then comes from something that stands in for the
    service, such as a proxy, so the service counts as away: ConnectionBrokeError.
    """
    secure = url.scheme == "https"
    try:
        connection = connect(
            url._replace(scheme="wss" if secure else "ws", path=url.path + PATH).geturl(),
            sock=socket.create_connection((url.hostname or "", url.port or (443 if secure else 80)), timeout),
            subprotocols=[Subprotocol(SUBPROTOCOL)],
            additional_headers={"Authorization": f"Bearer {token}"} if token else None,
            user_agent_header="wrongturn-client",
            compression=None,
            open_timeout=timeout,
            close_timeout=_CLOSE_TIMEOUT,
            ping_interval=None,
            max_size=None,
        ).__enter__()
    except InvalidStatus as failure:
        _refused(failure.response, offered=offered)
    except InvalidHandshake as failure:
        # With a forwarder whose service is away, the connection ends within the answer.
        ended = isinstance(failure, InvalidMessage) and isinstance(failure.__cause__, EOFError)
        if offered or ended:
            raise ConnectionBrokeError(f"the handshake failed: {failure}") from failure
        raise NotOfferedError(f"no WebSocket at {PATH}: {failure}") from failure
    if connection.subprotocol != SUBPROTOCOL:
        connection.close()
        raise NotOfferedError(f"the WebSocket at {PATH} speaks another protocol than {SUBPROTOCOL}")
    return connection


def _refused(response: Response, *, offered: bool) -> NoReturn:
    """Raise the error for a refused handshake."""
    status = response.status_code
    body = bytes(response.body or b"")
    reason = f"no WebSocket of {SUBPROTOCOL} at {PATH}: status {status}"
    if offered and status not in _BUSY and not (400 <= status < 500 and _is_own_problem(body)):
        raise ConnectionBrokeError(reason)
    if status not in _ANSWERS:
        raise NotOfferedError(reason)
    Answer(status, body, response.headers).checked()
    raise AssertionError("checked raises an error for these statuses")


def _is_own_problem(body: bytes) -> bool:
    """Tell whether a body is a problem of a Wrongturn service, rather than of a proxy before it."""
    try:
        return Problem.model_validate_json(body).type.rsplit("/", 1)[-1] in set(ProblemType)
    except ValidationError:
        return False
