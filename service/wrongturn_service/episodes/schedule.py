"""Which trial of an evaluation comes next."""

import hashlib
import hmac
from collections.abc import Iterable

from wrongturn_protocol import Trial, twin_id


def shuffled(trials: Iterable[Trial], secret: str) -> list[Trial]:
    """The trials in an order that only who knows the secret can tell, the same after a restart."""
    key = secret.encode()
    return sorted(trials, key=lambda trial: hmac.digest(key, trial.id.encode(), hashlib.sha256))


def pair_of(trial: Trial) -> str:
    """What a trial shares with its twin alone; a journey has none, and shares it with nobody."""
    return twin_id(trial) if trial.journey is None else trial.id


class Schedule:
    """An evaluation's trials: still to come, open, finished.

    A trial and its twin are never open at the same time, or an agent could tell a fault by comparing the two.
    """

    def __init__(self, trials: Iterable[Trial], secret: str, finished: Iterable[str] = ()) -> None:
        """Lay the trials out.

        Args:
            trials: the suite's trials and, but for journeys, twins.
            secret: what their order comes from.
            finished: ids of those that have their verdict.
        """
        done = frozenset(finished)
        self._pending = [trial for trial in shuffled(trials, secret) if trial.id not in done]
        self._open: dict[str, Trial] = {}

    @property
    def open(self) -> int:
        """How many are being driven."""
        return len(self._open)

    @property
    def finished(self) -> bool:
        """Whether each has its verdict."""
        return not self._pending and not self._open

    def take(self) -> Trial | None:
        """The next one, which counts as open from now on; None while only twins of open ones are left."""
        taken = {pair_of(trial) for trial in self._open.values()}
        for index, trial in enumerate(self._pending):
            if pair_of(trial) not in taken:
                del self._pending[index]
                self._open[trial.id] = trial
                return trial
        return None

    def put_back(self, trial: Trial) -> None:
        """It came to nothing and runs again."""
        if self._open.pop(trial.id, None) is not None:
            self._pending.insert(0, trial)

    def finish(self, trial: Trial) -> None:
        """It has its verdict."""
        self._open.pop(trial.id, None)
