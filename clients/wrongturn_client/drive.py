"""Driving over ``WS /v1/drive``: many episodes on one connection, many calls in one message."""

import uuid
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar
from urllib.parse import SplitResult

from pydantic import BaseModel, ValidationError

from wrongturn_client.availability import Availability
from wrongturn_client.closing import Closing
from wrongturn_client.connections import ConnectionBrokeError
from wrongturn_client.decoding import validated
from wrongturn_client.errors import ApiError, ProtocolError, ServiceBusyError, ServiceUnreachableError
from wrongturn_client.problems import api_error
from wrongturn_client.transport import attempts
from wrongturn_client.websocket import WebSocketConnection
from wrongturn_protocol import Action, EpisodeDetail, EpisodeReply, PracticeRequest, Problem, StepReply
from wrongturn_protocol.wire import (
    CALLS,
    RETRY_AFTER,
    Call,
    MalformedMessageError,
    arrays,
    pack_calls,
    unpack_results,
)

M = TypeVar("M", bound=BaseModel)
Result = dict[str, Any] | ApiError
"""The fields of a call's reply, its observation as arrays; or why it was refused."""
_NUMBERS: Final = 2**32
_STEP: Final = Call.STEP.value


class Drive(Closing):
    """A connection for driving; one thread's at a time.

    Where the connection breaks it is made again, and what was not answered is sent again: a step that was taken is
    not taken twice, by its ``seq``, nor is an episode begun twice, by its key. Make it by :meth:`Client.drive`.
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
        """Connect.

        Args:
            url: of the service.
            token: an agent's.
            timeout: seconds for each wait for an answer.
            patience: seconds for which is tried again while the service is busy or gone; 0 for never.
            availability: what is known of the service; nothing by default, and then it is given up soon.

        Raises:
            ServiceUnreachableError, NotOfferedError, ApiError.
        """
        self.patience = patience
        self._url = url
        self._availability = known = availability or Availability(url.geturl())
        self._make: Callable[[], WebSocketConnection] = lambda: WebSocketConnection(
            url, token, timeout, offered=known.offers_socket
        )
        self._connection: WebSocketConnection | None = None
        self._number = 0
        self._unanswered: dict[int, bytes] = {}
        self._early: dict[int, list[Result]] = {}
        self._connect()

    def close(self) -> None:
        """Close the connection; open episodes stay open."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    # Messages

    def submit(self, calls: Sequence[Sequence[Any]]) -> int:
        """Send one message of calls, as :mod:`wrongturn_protocol.wire` has them; its number.

        Raises:
            ServiceUnreachableError, ApiError.
        """
        if not 0 < len(calls) <= CALLS:
            raise ValueError(f"calls: are {len(calls)}; send 1 to {CALLS} in a message")
        self._number = number = (self._number + 1) % _NUMBERS
        self._unanswered[number] = message = pack_calls(number, calls)
        try:
            self._connected().send(message)
        except ConnectionBrokeError:
            self._connect()
        return number

    def receive(self) -> tuple[int, list[Result]]:
        """Number and results of the next message that is answered, whichever it is.

        Raises:
            ServiceUnreachableError: nobody answered for as long as the patience lasts.
            ApiError: the service refused the connection or a message; no single call.
        """
        if self._early:
            number = next(iter(self._early))
            return number, self._early.pop(number)
        return self._receive()

    def exchange(self, calls: Sequence[Sequence[Any]], patience: float | None = None) -> list[Result]:
        """The results of one message of calls; those that met a busy service are tried again for a while.

        Args:
            calls: as :meth:`submit` takes them.
            patience: seconds for which they are; the connection's own by default.
        """
        results = self._wait(self.submit(calls))
        for result in results:
            if isinstance(result, ServiceBusyError):
                self._try_again(calls, results, self.patience if patience is None else patience)
                break
        return results

    # Calls

    def next_episode(self, evaluation: str) -> EpisodeReply:
        """Reset: as :meth:`Client.next_episode`."""
        return self._one(EpisodeReply, [Call.NEXT, evaluation, str(uuid.uuid4())])

    def practise(self, request: PracticeRequest, *, key: str | None = None) -> EpisodeReply:
        """Reset: as :meth:`Client.practise`."""
        return self._one(EpisodeReply, practise_call(request, key))

    def step(self, episode: str, seq: int, action: Action) -> StepReply:
        """Drive on for 0.1 s: as :meth:`Client.step`."""
        return self._one(StepReply, step_call(episode, seq, action))

    def steps(self, steps: Sequence[tuple[str, int, Action]]) -> list[StepReply | ApiError]:
        """A step of each of several episodes, in one message: the reply to each, or why it was refused.

        Args:
            steps: episode, seq and action, as :meth:`step` takes them.
        """
        results = self.exchange([step_call(*step) for step in steps])
        return [result if isinstance(result, ApiError) else validated(StepReply, result) for result in results]

    def episode(self, episode: str) -> EpisodeDetail:
        """An episode: as :meth:`Client.episode`."""
        return self._one(EpisodeDetail, [Call.LOOK, episode])

    def abort_episode(self, episode: str) -> None:
        """End an episode: as :meth:`Client.abort_episode`."""
        (result,) = self.exchange([[Call.ABORT, episode]])
        if isinstance(result, ApiError):
            raise result

    # Small things

    def _one(self, kind: type[M], call: Sequence[Any]) -> M:
        (result,) = self.exchange([call])
        if isinstance(result, ApiError):
            raise result
        return validated(kind, result)

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
            if number is None:
                self.close()
                if read and isinstance(read[0], ApiError):
                    raise read[0]
                raise ProtocolError("the service's message has no number")
            # What was sent over two connections may be answered by both.
            if self._unanswered.pop(number, None) is not None:
                return number, read

    def _connected(self) -> WebSocketConnection:
        if self._connection is None:
            raise ConnectionBrokeError("the connection is closed")
        return self._connection

    def _connect(self) -> None:
        """Connect, and send again what was not answered."""
        before, self._connection = self._connection, None
        if before is not None:
            before.close()
        try:
            for attempt in attempts(self.patience, self._availability):
                with attempt:
                    connection = self._make()
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

    def _try_again(self, calls: Sequence[Sequence[Any]], results: list[Result], patience: float) -> None:
        """Send calls again that met a busy service; where it stays busy, that stays their result."""
        first = True
        try:
            for attempt in attempts(patience, self._availability):
                with attempt:
                    left = [at for at, result in enumerate(results) if isinstance(result, ServiceBusyError)]
                    if not first:
                        again = self._wait(self.submit([calls[at] for at in left]))
                        for at, result in zip(left, again, strict=True):
                            results[at] = result
                    first = False
                    busy = [result for result in results if isinstance(result, ServiceBusyError)]
                    if busy:
                        raise max(busy, key=lambda error: error.retry_after or 0.0)
        except ServiceBusyError:
            return


def step_call(episode: str, seq: int, action: Action) -> list[Any]:
    """The call of a step."""
    return [_STEP, episode, seq, action.steer, action.throttle, action.brake]


def practise_call(request: PracticeRequest, key: str | None = None) -> list[Any]:
    """The call of an episode for practice; sent again, it gives the same episode."""
    body = request.model_dump(mode="json", exclude_none=True)
    return [Call.PRACTISE.value, body, key or str(uuid.uuid4())]


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
        # A look's observation belongs to the reply that it tells again.
        holder = fields.get("last_reply", fields)
        try:
            holder["observation"] = arrays(result[2])
        except MalformedMessageError as error:
            raise ProtocolError(f"an observation cannot be read: {error}") from error
    return fields
