"""The order of an evaluation's trials."""

import hashlib
import hmac
from collections.abc import Iterable

from wrongturn_protocol import FaultKind, Trial, twin_id


def shuffled(trials: Iterable[Trial], secret: str) -> list[Trial]:
    """Return the trials in an order that follows from the secret alone, so that it survives a restart."""
    key = secret.encode()
    return sorted(trials, key=lambda trial: hmac.digest(key, trial.id.encode(), hashlib.sha256))


def pair_of(trial: Trial) -> str:
    """Return a name that a trial shares with its twin only: the twin's id. A journey has no twin."""
    return trial.id if trial.journey is not None or trial.fault.kind is FaultKind.NONE else twin_id(trial)


class Schedule:
    """An evaluation's trials: pending, open or finished.

    A trial and its twin are never open together: an agent that compares the two could tell the fault.
    """

    def __init__(self, trials: Iterable[Trial], secret: str, finished: Iterable[str] = ()) -> None:
        """Order the trials.

        Args:
            trials: The suite's trials with their twins; journeys have none.
            secret: Decides the order.
            finished: Ids of trials that have a verdict.
        """
        done = frozenset(finished)
        self._pending = [trial for trial in shuffled(trials, secret) if trial.id not in done]
        self._open: dict[str, Trial] = {}

    @property
    def open(self) -> int:
        """Number of trials that are being driven."""
        return len(self._open)

    @property
    def finished(self) -> bool:
        """Whether every trial has a verdict."""
        return not self._pending and not self._open

    def take(self) -> Trial | None:
        """Open the next trial and return it. None while only twins of open trials are left."""
        taken = {pair_of(trial) for trial in self._open.values()}
        for index, trial in enumerate(self._pending):
            if pair_of(trial) not in taken:
                del self._pending[index]
                self._open[trial.id] = trial
                return trial
        return None

    def put_back(self, trial: Trial) -> None:
        """Return an open trial, so that it runs again."""
        if self._open.pop(trial.id, None) is not None:
            self._pending.insert(0, trial)

    def finish(self, trial: Trial) -> None:
        """Note that an open trial has its verdict."""
        self._open.pop(trial.id, None)
