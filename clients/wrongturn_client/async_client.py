"""The calls of a Wrongturn service for asyncio: those of :class:`~wrongturn_client.Client`, each to be awaited."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from functools import partial, wraps
from typing import Any, Concatenate, Final, ParamSpec, Self, TypeVar

import httpx

from wrongturn_client.client import Client
from wrongturn_client.closing import Closing
from wrongturn_client.drive import DriveSocket

P = ParamSpec("P")
T = TypeVar("T")
_THREADS: Final = 32
"""Calls that wait for the service at a time; further calls wait for one of these."""


class _Awaitable:
    """Base of a client whose methods run those of a blocking client in threads."""

    def __init__(self, blocking: Closing, threads: int, name: str) -> None:
        self._blocking = blocking
        self._threads = ThreadPoolExecutor(threads, name)

    async def __aenter__(self) -> Self:
        """Return the client itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close the connections."""
        await self.close()

    async def close(self) -> None:
        """Close the connections; open episodes stay open."""
        await self._run(self._blocking.close)
        self._threads.shutdown(wait=False)

    async def _run(self, call: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, partial(call, *arguments, **keywords))


def _awaited(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Turn a method of the blocking client into a coroutine with the same arguments, result and docstring."""

    @wraps(method)
    async def call(self: _Awaitable, /, *arguments: P.args, **keywords: P.kwargs) -> T:
        return await self._run(getattr(self._blocking, method.__name__), *arguments, **keywords)

    return call


class AsyncDrive(_Awaitable):
    """WebSocket connection for driving, as :class:`~wrongturn_client.drive.DriveSocket`; calls run one after the other.

    Drive many episodes with :meth:`steps`, all in one message.
    """

    def __init__(self, drive: DriveSocket) -> None:
        # A thread of its own: only one thread may use a connection, and it must not wait for other calls.
        super().__init__(drive, 1, "wrongturn-drive")

    next_episode = _awaited(DriveSocket.next_episode)
    practise = _awaited(DriveSocket.practise)
    step = _awaited(DriveSocket.step)
    steps = _awaited(DriveSocket.steps)
    episode = _awaited(DriveSocket.episode)
    abort_episode = _awaited(DriveSocket.abort_episode)


class AsyncClient(_Awaitable):
    """Client of one service for asyncio; arguments, results and errors are those of :class:`~wrongturn_client.Client`.

    Each call waits in a thread, so neither the service nor a policy blocks the event loop. ``evaluate`` calls the
    policy and ``progress`` in such a thread.

    Example:
        >>> async with AsyncClient("http://127.0.0.1:8000") as client:  # doctest: +SKIP
        ...     print(await client.suites())
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        transport: httpx.BaseTransport | None = None,
        timeout: float = 30.0,
        patience: float = 60.0,
        binary: bool = True,
    ) -> None:
        """Create a client with the arguments of :class:`~wrongturn_client.Client`."""
        self._client = Client(url, token, transport=transport, timeout=timeout, patience=patience, binary=binary)
        super().__init__(self._client, _THREADS, "wrongturn-client")

    @property
    def url(self) -> str:
        """The service's URL."""
        return self._client.url

    live = _awaited(Client.live)
    ready = _awaited(Client.ready)
    submissions_state = _awaited(Client.submissions_state)
    simulators = _awaited(Client.simulators)
    suites = _awaited(Client.suites)
    suite = _awaited(Client.suite)
    trials = _awaited(Client.trials)
    towns = _awaited(Client.towns)
    town = _awaited(Client.town)

    register_owner = _awaited(Client.register_owner)
    owners = _awaited(Client.owners)
    owner = _awaited(Client.owner)
    rotate_owner_token = _awaited(Client.rotate_owner_token)
    revoke_owner_token = _awaited(Client.revoke_owner_token)

    register = _awaited(Client.register)
    agents = _awaited(Client.agents)
    agent = _awaited(Client.agent)
    rotate_token = _awaited(Client.rotate_token)
    revoke_token = _awaited(Client.revoke_token)

    create_evaluation = _awaited(Client.create_evaluation)
    evaluation = _awaited(Client.evaluation)
    cancel_evaluation = _awaited(Client.cancel_evaluation)
    next_episode = _awaited(Client.next_episode)
    open_episodes = _awaited(Client.open_episodes)
    finished_episodes = _awaited(Client.finished_episodes)
    put_results = _awaited(Client.put_results)
    run_file = _awaited(Client.run_file)
    save_run = _awaited(Client.save_run)
    evaluate = _awaited(Client.evaluate)

    practise = _awaited(Client.practise)
    whatif = _awaited(Client.whatif)
    step = _awaited(Client.step)
    episode = _awaited(Client.episode)
    trajectory = _awaited(Client.trajectory)
    plot = _awaited(Client.plot)
    view = _awaited(Client.view)
    abort_episode = _awaited(Client.abort_episode)

    submit = _awaited(Client.submit)
    submissions = _awaited(Client.submissions)
    submission = _awaited(Client.submission)
    submission_log = _awaited(Client.submission_log)
    cancel_submission = _awaited(Client.cancel_submission)

    leaderboards = _awaited(Client.leaderboards)
    leaderboard = _awaited(Client.leaderboard)
    leaderboard_csv = _awaited(Client.leaderboard_csv)
    compare = _awaited(Client.compare)

    async def drive(self) -> AsyncDrive:
        """Open a WebSocket connection for driving; see :meth:`Client.drive`."""
        return AsyncDrive(await self._run(self._client.drive))
