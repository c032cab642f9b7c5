"""One simulator, wherever its process runs. :mod:`wrongturn_service.simulators.worker` describes the messages."""

import asyncio
import contextlib
import os
from collections.abc import Callable
from typing import Any, Final, TypeVar

import msgpack
from typing_extensions import override

from wrongturn_protocol import Outcome, Sight
from wrongturn_protocol.rigs import text_of
from wrongturn_service.encoding import Encoding
from wrongturn_service.simulators.interface import (
    OK,
    REFUSED,
    Action,
    EpisodeEnd,
    EpisodeRefusedError,
    Place,
    SimulatorDiedError,
    StepResult,
    replay_s,
)

_T = TypeVar("_T")
_STEP_S: Final = 5.0
"""Seconds after which a step counts as hung. It takes milliseconds; only a reset may have to load a town."""


class Simulator(asyncio.Protocol):
    """One process, which drives one episode at a time. Calls raise SimulatorDiedError.

    A subclass starts the process, connects this protocol with it, and says how it is ended.
    """

    def __init__(self, timeout_s: float) -> None:
        """A call counts as hung after ``timeout_s``."""
        self.town: Place = ("", None)
        """The town that was driven in last."""
        self._handle = -1
        """Descriptor that requests are written to; -1 if only the transport can write."""
        self._transport: asyncio.Transport
        self._closed = False
        self._timeout_s = timeout_s
        self._step_s = min(timeout_s, _STEP_S)
        self._loop = asyncio.get_running_loop()
        self._replies = msgpack.Unpacker()
        self._reply: asyncio.Future[Any] | None = None
        self._read: Callable[..., Any]
        self._limit_s = self._deadline = 0.0
        self._alarm: asyncio.TimerHandle | None = None

    @property
    def name(self) -> str:
        """Which process it is, for the log."""
        raise NotImplementedError

    def memory(self) -> int:
        """Return the bytes of memory that the process takes of this machine."""
        raise NotImplementedError

    async def close(self) -> None:
        """End the process and wait until it has ended, as far as that can be known."""
        raise NotImplementedError

    def _end_process(self) -> None:
        """End the process at once."""
        raise NotImplementedError

    async def ready(self, timeout_s: float) -> None:
        """Wait until the process says that it is ready."""
        await self._expect(lambda *_: None, timeout_s)

    @property
    def dead(self) -> bool:
        """Whether it has ended; its episode has to be replayed in another one."""
        # The reply to a call that was given up would be taken for that to the next one.
        return self._closed or (self._reply is not None and self._reply.cancelled())

    async def reset(self, trial: str, sight: Sight, actions: bytes, encoding: Encoding) -> StepResult:
        """Begin an episode, repeat actions that were taken before, and return the result of the last one.

        ``trial`` is JSON of Trial; ``actions`` are little-endian float32 [n, 3]. Raises EpisodeRefusedError.
        """
        timeout_s = self._timeout_s + replay_s(actions)
        return await self._ask(["reset", trial, text_of(sight), actions, encoding.value], _step_result, timeout_s)

    def step(self, action: Action, encoding: Encoding) -> "asyncio.Future[StepResult]":
        """Drive one decision. Whoever cancels the future has to give the simulator up."""
        return self._ask(["step", *action, encoding.value], _step_result, self._step_s)

    async def abort(self) -> EpisodeEnd:
        """End the episode as ``aborted``."""
        return await self._ask(["abort"], _episode_end, self._timeout_s)

    async def view(self) -> bytes:
        """Return a picture of the moment for people, as a pixmap."""
        return await self._ask(["view"], bytes, self._timeout_s)

    async def prepare(self, town: Place) -> None:
        """Load a town, so that its first reset is as quick as any other. Raises SimulatorDiedError."""
        await self._ask(["prepare", *town], lambda *_: None, self._timeout_s)
        self.town = town

    def _kill(self, reason: str) -> None:
        """End the process at once; an awaited reply fails."""
        self._transport.abort()
        self._end_process()
        self._end(reason)

    def _end(self, reason: str) -> None:
        self._closed = True
        if self._alarm is not None:
            self._alarm.cancel()
        if self._reply is not None and not self._reply.done():
            self._reply.set_exception(SimulatorDiedError(reason))

    def _ask(self, request: list[object], read: Callable[..., _T], timeout_s: float) -> "asyncio.Future[_T]":
        """Send a request, and return its reply: what ``read`` makes of the values after :data:`OK`."""
        if not self.dead:
            data, sent = msgpack.packb(request), 0
            if self._handle >= 0:
                # The transport would write at the end of the loop's turn. It meets the same errors, and tells of them.
                with contextlib.suppress(OSError):
                    sent = os.write(self._handle, data)
            if sent < len(data):
                self._transport.write(data[sent:])
        return self._expect(read, timeout_s)

    def _expect(self, read: Callable[..., _T], timeout_s: float) -> "asyncio.Future[_T]":
        reply: asyncio.Future[_T] = self._loop.create_future()
        if self.dead:
            self._kill("a call was given up")
            reply.set_exception(SimulatorDiedError("the simulator process ended"))
            return reply
        self._reply, self._read = reply, read
        self._limit_s, self._deadline = timeout_s, self._loop.time() + timeout_s
        # An earlier alarm stays, and sets the next one: moving it takes time each step.
        if self._alarm is None or self._alarm.when() > self._deadline:
            self._set_alarm()
        return reply

    def _set_alarm(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
        self._alarm = self._loop.call_at(self._deadline, self._look)

    def _look(self) -> None:
        self._alarm = None
        if self._reply is None:
            return
        if self._loop.time() < self._deadline:
            self._set_alarm()
        else:
            self._kill(f"the simulator process did not answer within {self._limit_s:g} s")

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._transport = transport

    @override
    def data_received(self, data: bytes) -> None:
        self._replies.feed(data)
        for status, *values in self._replies:
            reply, self._reply = self._reply, None
            if reply is None or reply.cancelled():
                self._kill("a call was given up")
            elif status == OK:
                reply.set_result(self._read(*values))
            elif status == REFUSED:
                reply.set_exception(EpisodeRefusedError(*values))
            else:  # its state is unknown, and the next episode must not inherit it
                self._kill("")
                reply.set_exception(SimulatorDiedError(": ".join(values)))

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._end("the simulator process ended")


def _step_result(
    observation: bytes, reward: float, terminated: bool, truncated: bool, end: list[Any] | None
) -> StepResult:
    return StepResult(observation, reward, terminated, truncated, None if end is None else _episode_end(*end))


def _episode_end(outcome: str, *values: Any) -> EpisodeEnd:
    return EpisodeEnd(Outcome.model_validate_json(outcome), *values)
