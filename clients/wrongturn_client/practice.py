"""What the environments over the wire have of a service: an agent for practice, trials and a line to drive on."""

import contextlib
import secrets
import uuid
from collections.abc import Iterator, Sequence
from typing import Any, Final

import httpx
import numpy as np

from wrongturn_client import settings
from wrongturn_client.client import Client
from wrongturn_client.closing import Closing
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result, practise_call
from wrongturn_client.errors import ApiError, WrongturnError
from wrongturn_client.practice_source import PracticeSource
from wrongturn_protocol import TrialOptions
from wrongturn_protocol.wire import CALLS, Call

_THREADS: Final = 16
"""Calls over HTTP at a time."""
_GOODBYE: Final = 2.0
"""Seconds that a service which is gone is tried again for to end episodes."""


class Practice(Closing):
    """An agent's practice, made when it is first needed: an environment may be made in one process and used in another.

    Args:
        options: what is drawn.
        url: of the service; ``WRONGTURN_URL`` by default.
        token: an agent's; ``WRONGTURN_TOKEN`` by default. Where there is none, an agent for practice is registered.
        patience: seconds for which is tried again while the service is busy or gone.
        transport: of httpx, for tests.

    Raises:
        ValueError: the patience is no number of seconds.
    """

    def __init__(
        self,
        options: TrialOptions,
        url: str | None,
        token: str | None,
        patience: float = 60.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        if isinstance(patience, bool) or not isinstance(patience, int | float) or not patience >= 0:
            raise ValueError(f"patience: is {patience!r}; give seconds, 0 or more")
        self.patience = patience
        self._track = options.track
        self._source = PracticeSource(options)
        self._url = url
        self._token = token or settings.token()
        self._transport = transport
        self._client: Client | None = None
        self._connection: DriveConnection | None = None

    @property
    def url(self) -> str:
        """The service's URL."""
        return self._connected().url

    def call(self, random: np.random.Generator, trial: str | None = None) -> list[Any]:
        """The call by which the next trial begins; sent again, it gives the same episode.

        Raises:
            ValueError, WrongturnError: as :meth:`PracticeSource.draw`.
        """
        return practise_call(self._source.draw(self._connected(), random, trial))

    def again(self, call: list[Any]) -> list[Any]:
        """The same trial, as another episode."""
        return [*call[:2], str(uuid.uuid4())]

    def slots(self) -> int | None:
        """How many episodes the service can drive at a time; None where it does not say."""
        try:
            return self._connected().simulators()
        except ApiError:
            return None

    def exchange(self, calls: Sequence[EpisodeCall], patience: float | None = None) -> list[Result]:
        """Return the results of any number of calls; raises as ``DriveConnection.exchange``."""
        if self._connection is None:
            self._connection = self._connected().connection(_THREADS)
        return [result for some in _messages(calls) for result in self._connection.exchange(some, patience)]

    def abort(self, episodes: Sequence[str]) -> None:
        """End episodes: those that nobody drives on would hold their simulators until the service gives them up."""
        if self._connection is None or not episodes:
            return
        self._connection.patience = min(_GOODBYE, self.patience)
        with contextlib.suppress(WrongturnError):
            self.exchange([[Call.ABORT.value, episode] for episode in episodes])
        self._connection.patience = self.patience

    def close(self) -> None:
        """Close the connections; they are made again when they are needed again."""
        for one in (self._connection, self._client):
            if one is not None:
                one.close()
        self._connection = self._client = None

    def _make(self) -> Client:
        return Client(self._url, self._token, transport=self._transport, patience=self.patience)

    def _connected(self) -> Client:
        if self._client is None:
            if self._token is None:
                with self._make() as client:
                    name = f"practice-{secrets.token_hex(6)}"
                    self._token = client.register(name, self._track, description="Registered for practice.").token
            self._client = self._make()
        return self._client


def _messages(calls: Sequence[EpisodeCall]) -> Iterator[Sequence[EpisodeCall]]:
    for begin in range(0, len(calls), CALLS):
        yield calls[begin : begin + CALLS]
