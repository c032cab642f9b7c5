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

from wrongturn_client import ApiError, Client
from wrongturn_client.drive import DriveSocket
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result
from wrongturn_client.http_drive import HttpDrive
from wrongturn_protocol import EvaluationState
from wrongturn_protocol.wire import Call

HTTP, SOCKET = "HTTP", "socket"


class Journal:
    """Lines that outlive the process by the time they are written."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def note(self, what: str, **fields: Any) -> None:
        line = json.dumps({"what": what, "time": time.time(), **fields}) + "\n"
        os.write(self._file, line.encode())


class Watched(DriveConnection):
    """Notes the last reply of each episode."""

    journal: Journal

    def exchange(self, calls: Sequence[EpisodeCall]) -> list[Result]:
        began = time.time()
        results = super().exchange(calls)
        for call, result in zip(calls, results, strict=True):
            if isinstance(result, ApiError):
                self.journal.note("refused", problem=result.type)
            elif call[0] == Call.STEP and (result["terminated"] or result["truncated"]):
                self.journal.note("final", episode=call[1], seq=result["seq"])
        if not any(isinstance(result, ApiError) for result in results):
            self.journal.note("exchange", began=began)
        return results


class WatchedDrive(Watched, DriveSocket):
    """Over the socket."""


class WatchedHttpDrive(Watched, HttpDrive):
    """Over HTTP."""


class WatchedClient(Client):
    """Drives over the channel that is asked for, and notes what it is told."""

    def __init__(self, journal: Journal, url: str, token: str, channel: str) -> None:
        super().__init__(url, token, patience=120.0)
        self._journal = journal
        self._channel = channel

    def connection(self, parallel: int) -> DriveConnection:
        connection: Watched
        if self._channel == HTTP:
            connection = WatchedHttpDrive(self, 120.0, parallel)
        else:
            contact = self._transport.contact
            connection = WatchedDrive(urlsplit(self.url), self._token, timeout=30.0, patience=120.0, contact=contact)
        connection.journal = self._journal
        return connection


def main() -> None:
    url, token, evaluation, suite, name, channel, parallel, path = sys.argv[1:]
    journal = Journal(path)
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
