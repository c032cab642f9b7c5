"""The calls of ``WS /v1/drive``: each means the same as its REST call, and has its own result or problem."""

import asyncio
import contextlib
import json
import time
from collections.abc import Callable
from functools import partial
from inspect import signature
from typing import Any, Final

import msgpack
from pydantic import ValidationError

from wrongturn_protocol import PracticeRequest, StepRequest
from wrongturn_protocol.wire import PATH, RETRY_AFTER, Call, pack_result
from wrongturn_service import catalogue, logs
from wrongturn_service.accounts import Caller
from wrongturn_service.api.body import refused
from wrongturn_service.api.dependencies import driven_by
from wrongturn_service.api.episodes import episode_detail, is_shown
from wrongturn_service.api.errors import as_service_error
from wrongturn_service.encoding import Encoding, Reply
from wrongturn_service.errors import InvalidRequestError, ServiceError
from wrongturn_service.idempotency import StoredReplyError
from wrongturn_service.service import Service
from wrongturn_service.simulators.interface import Action, rounded

_UNKNOWN: Final = "unknown"
_NUMBERS: Final = {float, int}
"""Some clients' languages write 0.0 as the integer 0."""
_READS: Final = 2
"""Calls of a connection that are answered from the database at a time."""
_LONGEST_ID: Final = 64
_STEP_ROUTE: Final = f"{PATH} {Call.STEP}"


class Calls:
    """Answers the calls of one agent."""

    def __init__(self, service: Service, caller: Caller, address: str) -> None:
        self._service = service
        self._caller = caller
        self._address = address
        self._reading = asyncio.Semaphore(_READS)

    def begin(self, call: Any, done: Callable[[bytes | Reply], None]) -> bool:
        """Begin a step the short way, without a task; nearly every step can go this way. ``done`` gets the result.

        Return whether it has begun; otherwise nothing has happened.
        """
        step = _plain_step(call)
        if step is None:
            return False
        return self._service.episodes.begin_step(
            self._caller.holder, *step, Encoding.RAW, partial(self._stepped, time.perf_counter(), done)
        )

    def _stepped(
        self, began: float, done: Callable[[bytes | Reply], None], outcome: Reply | Exception, simulated_s: float | None
    ) -> None:
        telemetry = self._service.telemetry
        status = 200
        if isinstance(outcome, Exception):
            problem = as_service_error(outcome)
            status = problem.status
            done(problem_result(problem))
        else:
            done(outcome)
        seconds = time.perf_counter() - began
        if status == 200 and simulated_s is not None:
            telemetry.stepped(_STEP_ROUTE, simulated_s, seconds)
        else:
            telemetry.answered("WS", _STEP_ROUTE, status, seconds)

    async def answer(self, call: Any) -> bytes:
        """Return the packed result of one call; an error is a result too."""
        began = time.perf_counter()
        logs.begin_request()
        name: str = _UNKNOWN
        status = 200
        try:
            if not isinstance(call, list) or not call or call[0] not in list(Call):
                raise InvalidRequestError("call", f"has to be an array that begins with one of {', '.join(Call)}")
            name, *arguments = call
            method = getattr(self, f"_{name}")
            shape = list(signature(method).parameters)
            if len(arguments) != len(shape):
                raise InvalidRequestError("call", f"has to be [{name}, {', '.join(shape)}]")
            result: bytes = await method(*arguments)
        except StoredReplyError as answered:
            result = answered.stored.body
        except Exception as error:
            problem = as_service_error(error)
            status, result = problem.status, problem_result(problem)
        self._service.telemetry.answered("WS", f"{PATH} {name}", status, time.perf_counter() - began)
        return result

    async def _step(self, episode: Any, seq: Any, steer: Any, throttle: Any, brake: Any) -> bytes:
        message = {"seq": seq, "action": {"steer": steer, "throttle": throttle, "brake": brake}}
        try:
            request = StepRequest.model_validate(message, strict=True)
        except ValidationError as error:
            raise refused(error) from error
        wanted = _id("episode", episode)
        async with self._in_line(wanted):
            return await self._service.episodes.step(self._caller, wanted, request, Encoding.RAW)

    async def _next(self, evaluation: Any, key: Any) -> bytes:
        service, caller = self._service, self._caller
        wanted = _id("evaluation", evaluation)
        with service.resets.in_progress.one(wanted):
            call = f"WS {Call.NEXT} {wanted}"
            async with service.idempotency.once(_key(key), caller.holder, call, b"", self._reading) as once:
                async with self._reading:
                    row = await driven_by(service, caller, wanted)
                return await service.resets.next(caller, self._address, row, Encoding.RAW, once)

    async def _practise(self, request: Any, key: Any) -> bytes:
        service, caller = self._service, self._caller
        try:
            wanted = PracticeRequest.model_validate_json(json.dumps(request), strict=True)
        except ValidationError as error:
            raise refused(error) from error
        except (TypeError, ValueError, RecursionError) as error:
            raise InvalidRequestError("request", "has to be a map of plain values") from error
        caller.check_practice()
        canonical = wanted.model_dump_json().encode()
        call = f"WS {Call.PRACTISE}"
        async with service.idempotency.once(_key(key), caller.holder, call, canonical, self._reading) as once:
            caller.check_track(wanted)
            trial = await catalogue.practice_trial(wanted, service.draws)
            return await service.resets.practise(caller, self._address, trial, Encoding.RAW, once)

    async def _look(self, episode: Any) -> bytes:
        service, wanted = self._service, _id("episode", episode)
        async with self._reading:
            row = await service.episodes.look(self._caller, wanted)
            self._caller.check_episode(row)
            detail = episode_detail(service, row, shown=await is_shown(service, row), last_reply=False).model_dump(
                mode="json"
            )
        last = service.episodes.last_reply(wanted, Encoding.RAW)
        if last is None:
            return pack_result(200, detail)
        detail["seq"] = last[0]
        _, detail["last_reply"], observation = msgpack.unpackb(last[1])
        return pack_result(200, detail, observation)

    async def _abort(self, episode: Any) -> bytes:
        wanted = _id("episode", episode)
        async with self._in_line(wanted):
            await self._service.episodes.abort(self._caller, wanted)
        return pack_result(204, {})

    def _in_line(self, episode: str) -> contextlib.AbstractAsyncContextManager[None]:
        """Return what a call on an episode waits for. One that is open may wait for a simulator, so it has no line."""
        return contextlib.nullcontext() if episode in self._service.episodes.registry else self._reading


def problem_result(error: ServiceError) -> bytes:
    """Return the packed result of a call that is refused."""
    fields = error.problem().model_dump(mode="json")
    after = error.headers.get("Retry-After")
    if after is not None:
        fields[RETRY_AFTER] = int(after)
    return pack_result(error.status, fields)


def _plain_step(call: Any) -> tuple[str, int, Action] | None:
    """Return episode, seq and action of a step whose values are all valid; None for any other call."""
    if type(call) is not list or len(call) != 6 or call[0] != "step":
        return None
    _, episode, seq, steer, throttle, brake = call
    if type(episode) is not str or type(seq) is not int:
        return None
    if not type(steer) is type(throttle) is type(brake) is float and not {*map(type, call[3:])} <= _NUMBERS:
        return None
    if not (-1.0 <= steer <= 1.0 and 0.0 <= throttle <= 1.0 and 0.0 <= brake <= 1.0):
        return None
    return episode, seq, rounded(steer, throttle, brake)


def _text(path: str, value: Any) -> str:
    if not isinstance(value, str) or "\0" in value:
        raise InvalidRequestError(path, "has to be a string without the character NUL")
    return value


def _id(path: str, value: Any) -> str:
    text = _text(path, value)
    if len(text) > _LONGEST_ID:
        raise InvalidRequestError(path, f"has more than {_LONGEST_ID} characters, which no id has")
    return text


def _key(value: Any) -> str | None:
    return None if value is None else _text("key", value)
