"""Over what an environment's episodes are driven: the socket, or HTTP where there is none."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Any, Final, Protocol

from wrongturn_client.client import Client
from wrongturn_client.closing import Closing
from wrongturn_client.drive import Result
from wrongturn_client.errors import ApiError, NotOfferedError
from wrongturn_protocol import Action, PracticeRequest
from wrongturn_protocol.wire import Call

_THREADS: Final = 16
"""Calls over HTTP at a time."""


class Line(Protocol):
    """Takes the calls of :mod:`wrongturn_protocol.wire`."""

    patience: float
    """Seconds for which is tried again while the service is gone, or busy where nothing else is said."""

    def exchange(self, calls: Sequence[Sequence[Any]], patience: float | None = None) -> list[Result]:
        """The result of each call; those that meet a busy service are tried again for ``patience`` seconds.

        Raises:
            ServiceUnreachableError: nobody answers. The calls may be sent again: none has its effect twice.
        """
        ...

    def close(self) -> None:
        """Close; open episodes stay open."""


class HttpLine(Closing):
    """The same over HTTP, the calls of a message side by side."""

    def __init__(self, make: Callable[[float], Client], patience: float) -> None:
        """Open nothing yet.

        Args:
            make: a client of so many seconds' patience.
            patience: see :class:`Line`.
        """
        self.patience = patience
        self._make = make
        self._clients: dict[float, Client] = {}
        self._threads: ThreadPoolExecutor | None = None

    def exchange(self, calls: Sequence[Sequence[Any]], patience: float | None = None) -> list[Result]:
        """See :class:`Line`."""
        seconds = self.patience if patience is None else patience
        if seconds not in self._clients:
            self._clients[seconds] = self._make(seconds)
        answer = partial(_answer, self._clients[seconds])
        if len(calls) == 1:
            return [answer(calls[0])]
        if self._threads is None:
            self._threads = ThreadPoolExecutor(_THREADS, "wrongturn-line")
        answers = [self._threads.submit(answer, call) for call in calls]
        wait(answers)  # where one fails too: none may still be under way when it is sent again
        return [one.result() for one in answers]

    def close(self) -> None:
        """Close the connections."""
        if self._threads is not None:
            self._threads.shutdown()
            self._threads = None
        while self._clients:
            self._clients.popitem()[1].close()


def _answer(client: Client, call: Sequence[Any]) -> Result:
    kind, *given = call
    try:
        if kind == Call.STEP:
            episode, seq, steer, throttle, brake = given
            return dict(client.step(episode, seq, Action(steer=steer, throttle=throttle, brake=brake)))
        if kind == Call.PRACTISE:
            request, key = given
            return dict(client.practise(PracticeRequest.model_validate(request), key=key))
        if kind == Call.ABORT:
            client.abort_episode(given[0])
            return {}
    except ApiError as error:
        return error
    raise ValueError(f"call: {kind!r} is none of an environment's")


def line(make: Callable[[float], Client], patience: float) -> Line:
    """The socket where it is offered, else HTTP.

    Args:
        make: a client of so many seconds' patience.
        patience: see :class:`Line`.

    Raises:
        ServiceUnreachableError, ApiError.
    """
    try:
        with make(patience) as client:
            return client.drive()
    except NotOfferedError:
        return HttpLine(make, patience)
