"""Driving the trials of an evaluation over one socket: the steps of all open episodes go in one message."""

import contextlib
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from wrongturn_client.deciding import Waiting, decide, give_up
from wrongturn_client.decoding import track_of_message
from wrongturn_client.drive import Drive, Result, step_call
from wrongturn_client.errors import (
    ApiError,
    EpisodeFinishedError,
    EpisodeLostError,
    EvaluationFinishedError,
    NoTrialAvailableError,
    ProtocolError,
    ServiceBusyError,
)
from wrongturn_client.policy import Policy
from wrongturn_client.recorder import EpisodeRecorder
from wrongturn_protocol import Action
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_protocol.wire import CALLS, Call


@dataclass
class _Driven:
    """One open episode."""

    episode: str
    seq: int
    observation: Observation
    record: EpisodeRecorder | None
    """None of one whose first actions another program took."""
    action: Action | None = None
    """Under way."""


class EvaluationDriver:
    """Drives one policy through one evaluation.

    Trials are asked for beside the steps, each in a message of its own: a reset takes as long as dozens of steps.
    """

    def __init__(
        self,
        drive: Drive,
        policy: Policy,
        evaluation: str,
        *,
        parallel: int,
        resumed: Iterable[str] = (),
        on_end: Callable[[EpisodeRecorder | None], None],
    ) -> None:
        """Nothing is driven yet.

        Args:
            drive: the connection.
            policy: what decides.
            evaluation: its id.
            parallel: episodes at a time.
            resumed: open episodes that are gone on with first.
            on_end: called with the record of each episode that is over; with None for one that was resumed.
        """
        self._drive = drive
        self._policy = policy
        self._evaluation = evaluation
        self._parallel = min(parallel, CALLS // 2)
        self._resumed = deque(resumed)
        self._on_end = on_end
        self._asked: dict[int, list[Any]] = {}
        """Calls for a trial, or for the state of one that is resumed, by their message's number."""
        self._stepping: dict[int, list[_Driven]] = {}
        self._ready: list[_Driven] = []
        self._over = False
        self._ask_at = 0.0
        self._waiting = Waiting(evaluation)

    def run(self) -> None:
        """Drive until no trial is left; raises as :meth:`wrongturn_client.Client.evaluate`."""
        with _acting(self._parallel) as run:
            while True:
                self._ask()
                if self._ready and not self._stepping:
                    self._step(run)
                if self._asked or self._stepping:
                    self._take(*self._drive.receive())
                elif self._over and not self._resumed:
                    return
                else:
                    time.sleep(max(0.0, self._ask_at - time.monotonic()))

    def _ask(self) -> None:
        """For as many trials as there is room for."""
        room = self._parallel - len(self._asked) - len(self._ready) - sum(map(len, self._stepping.values()))
        while room > 0:
            if self._resumed:
                call = [Call.LOOK.value, self._resumed.popleft()]
            elif self._over or time.monotonic() < self._ask_at:
                return
            else:
                call = [Call.NEXT.value, self._evaluation, str(uuid.uuid4())]
            self._asked[self._drive.submit([call])] = call
            room -= 1

    def _step(self, run: Callable[[Callable[[_Driven], None], list[_Driven]], None]) -> None:
        driven, self._ready = self._ready, []
        run(self._decide, driven)
        calls = []
        for one in driven:
            assert one.action is not None
            calls.append(step_call(one.episode, one.seq + 1, one.action))
        self._stepping[self._drive.submit(calls)] = driven

    def _decide(self, one: _Driven) -> None:
        try:
            action, latency = decide(self._policy, one.observation)
        except Exception:
            give_up(self._drive.abort_episode, one.episode)
            raise
        one.action = action
        if one.record is not None:
            one.record.add(action, latency)

    def _take(self, number: int, results: list[Result]) -> None:
        call = self._asked.pop(number, None)
        if call is not None:
            self._begin(call, results[0])
            return
        for one, result in zip(self._stepping.pop(number), results, strict=True):
            self._advance(one, result)

    def _begin(self, call: list[Any], result: Result) -> None:
        if isinstance(result, ServiceBusyError):
            (result,) = self._drive.exchange([call])
        looked = call[0] == Call.LOOK
        match result:
            case EvaluationFinishedError():
                self._over = True
            case NoTrialAvailableError():
                self._ask_at = self._waiting.pause(result) + time.monotonic()
            case ApiError():
                raise result
            case _ if not looked:
                self._start(_Driven(result["id"], 0, result["observation"], EpisodeRecorder(result["id"])))
            case _ if result.get("last_reply"):  # else it ended meanwhile
                last = result["last_reply"]
                self._start(_Driven(result["id"], int(last["seq"]), last["observation"], None))

    def _start(self, one: _Driven) -> None:
        self._waiting.ended()
        try:
            self._policy.reset(observation_space(track_of_message(one.observation)))
        except Exception:
            give_up(self._drive.abort_episode, one.episode)
            raise
        self._ready.append(one)

    def _advance(self, one: _Driven, result: Result) -> None:
        if isinstance(result, ServiceBusyError):
            assert one.action is not None
            (result,) = self._drive.exchange([step_call(one.episode, one.seq + 1, one.action)])
        if isinstance(result, EpisodeLostError):
            return
        if isinstance(result, EpisodeFinishedError) and one.record is None:
            self._end(one)
            return
        if isinstance(result, ApiError):
            raise result
        if result["seq"] != one.seq + 1:
            raise ProtocolError(
                f"seq: the reply to step {one.seq + 1} of episode {one.episode} has {result['seq']}",
            )
        if result["terminated"] or result["truncated"]:
            self._end(one)
            return
        one.seq += 1
        one.observation = result["observation"]
        self._ready.append(one)

    def _end(self, one: _Driven) -> None:
        # A place is free, and perhaps a twin: no need to wait out the pause.
        self._ask_at = 0.0
        self._waiting.ended()
        self._on_end(one.record)


@contextlib.contextmanager
def _acting(parallel: int) -> Iterator[Callable[[Callable[[_Driven], None], list[_Driven]], None]]:
    """What runs the decisions of a round: in threads where there are several at a time."""
    if parallel == 1:
        yield lambda decide, driven: decide(driven[0])
        return
    with ThreadPoolExecutor(parallel) as threads:

        def run(decide: Callable[[_Driven], None], driven: list[_Driven]) -> None:
            for _ in threads.map(decide, driven):
                pass

        yield run
