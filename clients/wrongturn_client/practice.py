"""What the environments over the wire share: an agent for practice, trials to draw and a connection to drive on."""

import contextlib
import secrets
import uuid
from collections.abc import Iterator, Sequence
from typing import Any, Final

import httpx
import numpy as np
from numpy.typing import NDArray

from wrongturn_client import settings
from wrongturn_client.client import Client
from wrongturn_client.closing import Closing
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result, practise_call
from wrongturn_client.errors import ApiError, WrongturnError
from wrongturn_client.practice_source import PracticeSource
from wrongturn_protocol import Track, TrialOptions
from wrongturn_protocol.wire import CALLS, Call

_THREADS: Final = 16
"""Calls over HTTP at a time."""
_GOODBYE: Final = 2.0
"""Seconds for which to try to end episodes when the service does not answer."""


class Practice(Closing):
    """Practice of one agent. It connects on first use, so you can make it in one process and use it in another.

    Args:
        options: The trials to draw.
        url: The service's URL; ``WRONGTURN_URL`` by default.
        token: An agent's token; ``WRONGTURN_TOKEN`` by default. Without one, an agent for practice is registered.
        patience: Seconds for which calls are repeated while the service is busy or does not answer.
        transport: An httpx transport, for tests.

    Raises:
        ValueError: The patience is not a number of seconds.
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
        """Draw a trial and return the call that begins it; raise as :meth:`PracticeSource.draw`.

        If you send the call twice, both replies name the same episode.
        """
        return practise_call(self._source.draw(self._connected(), random, trial))

    def again(self, call: list[Any]) -> list[Any]:
        """Return the call that begins another episode of the same trial."""
        return [*call[:2], str(uuid.uuid4())]

    def slots(self) -> int | None:
        """Return how many episodes the service can drive at a time; None if it does not say."""
        try:
            return self._connected().simulators()
        except ApiError:
            return None

    def exchange(self, calls: Sequence[EpisodeCall], patience: float | None = None) -> list[Result]:
        """Return the results of any number of calls; raises as ``DriveConnection.exchange``."""
        if self._connection is None:
            self._connection = self._connected().connection(_THREADS)
        return [result for some in _messages(calls) for result in self._connection.exchange(some, patience)]

    def view(self, episode: str) -> NDArray[np.uint8]:
        """Return a picture of an episode's moment; raises as :meth:`Client.view`."""
        return self._connected().view(episode)

    def abort(self, episodes: Sequence[str]) -> None:
        """End episodes, which otherwise keep their simulators until the service gives them up."""
        if self._connection is None or not episodes:
            return
        self._connection.patience = min(_GOODBYE, self.patience)
        with contextlib.suppress(WrongturnError):
            self.exchange([[Call.ABORT.value, episode] for episode in episodes])
        self._connection.patience = self.patience

    def close(self) -> None:
        """Close the connections; the next call opens them again."""
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
                    self._token = practice_token(client, self._track)
            self._client = self._make()
        return self._client


def practice_token(client: Client, track: Track) -> str:
    """Register an agent for practice in a track, and return its token."""
    name = f"practice-{secrets.token_hex(6)}"
    return client.register(name, track, description="Registered for practice.").token


def _messages(calls: Sequence[EpisodeCall]) -> Iterator[Sequence[EpisodeCall]]:
    for begin in range(0, len(calls), CALLS):
        yield calls[begin : begin + CALLS]
