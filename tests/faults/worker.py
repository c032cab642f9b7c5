"""The client that is killed: drives one evaluation, or goes on with it, and notes at once what it was told.

Run as ``python worker.py URL TOKEN EVALUATION SUITE POLICY CHANNEL PARALLEL JOURNAL``. What a line of the journal
says was said by the service before: it is the witness of what was acknowledged.
"""

import json
import os
import sys
import time
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from policies import policy
from stamina import instrumentation

from wrongturn_client import ApiError, Client, NotOfferedError
from wrongturn_client.drive import Drive, Result
from wrongturn_protocol import Action, EvaluationState, StepReply
from wrongturn_protocol.wire import Call

HTTP, SOCKET = "HTTP", "socket"


class Journal:
    """Lines that outlive the process by the time they are written."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def note(self, what: str, **fields: Any) -> None:
        line = json.dumps({"what": what, "time": time.time(), **fields}) + "\n"
        os.write(self._file, line.encode())


class WatchedDrive(Drive):
    """Notes the last reply of each episode."""

    def __init__(self, journal: Journal, *arguments: Any, **options: Any) -> None:
        self._journal = journal
        self._calls: dict[int, Sequence[Sequence[Any]]] = {}
        super().__init__(*arguments, **options)

    def submit(self, calls: Sequence[Sequence[Any]]) -> int:
        number = super().submit(calls)
        self._calls[number] = calls
        return number

    def receive(self) -> tuple[int, list[Result]]:
        number, results = super().receive()
        self._note(self._calls.pop(number), results)
        return number, results

    def exchange(self, calls: Sequence[Sequence[Any]]) -> list[Result]:
        results = super().exchange(calls)
        self._note(calls, results)
        return results

    def _note(self, calls: Sequence[Sequence[Any]], results: list[Result]) -> None:
        for call, result in zip(calls, results, strict=True):
            if isinstance(result, ApiError):
                self._journal.note("refused", problem=result.type)
            elif call[0] == Call.STEP and (result["terminated"] or result["truncated"]):
                self._journal.note("final", episode=call[1], seq=result["seq"])


class WatchedClient(Client):
    """The same over HTTP, and over the socket where that is asked for."""

    def __init__(self, journal: Journal, url: str, token: str, channel: str) -> None:
        super().__init__(url, token, patience=120.0)
        self._journal = journal
        self._channel = channel
        self._own_token = token

    def step(self, episode: str, seq: int, action: Action) -> StepReply:
        try:
            reply = super().step(episode, seq, action)
        except ApiError as error:
            self._journal.note("refused", problem=error.type)
            raise
        if reply.terminated or reply.truncated:
            self._journal.note("final", episode=episode, seq=reply.seq)
        return reply

    def drive(self) -> Drive:
        if self._channel == HTTP:
            raise NotOfferedError("this one goes by HTTP")
        return WatchedDrive(self._journal, urlsplit(self.url), self._own_token, patience=120.0)


def main() -> None:
    url, token, evaluation, suite, name, channel, parallel, path = sys.argv[1:]
    journal = Journal(path)
    instrumentation.set_on_retry_hooks((lambda details: journal.note("retry", error=repr(details.caused_by)[:200]),))
    journal.note("began")
    try:
        with WatchedClient(journal, url, token, channel) as client:
            done = client.evaluate(policy(name), suite, evaluation=evaluation, parallel=int(parallel))
    except Exception as error:
        journal.note("gave up", error=f"{type(error).__name__}: {error}"[:400])
        raise
    if done.state is EvaluationState.FINISHED and done.metrics is not None:
        journal.note("finished", evaluation=evaluation, trials=done.trials)


if __name__ == "__main__":
    main()
