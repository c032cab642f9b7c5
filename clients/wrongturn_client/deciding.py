"""What driving a policy takes, over HTTP and the socket alike: asking it, giving an episode up, waiting for a trial."""

import contextlib
import time
from collections.abc import Callable
from typing import Final

from wrongturn_client.actions import refusal
from wrongturn_client.errors import EvaluationStalledError, NoTrialAvailableError, PolicyError, WrongturnError
from wrongturn_client.policy import Policy
from wrongturn_protocol import Action
from wrongturn_protocol.observations import Observation

_STALLED_AFTER: Final = 900.0
"""Seconds without a trial; a worker that vanished is given up by the service after 600."""
_PAUSE: Final = 1.0
"""Seconds, where the service does not say when a trial can be had."""
_LONGEST_PAUSE: Final = 10.0


def decide(policy: Policy, observation: Observation) -> tuple[Action, float]:
    """What a policy does, and the seconds that it took to decide.

    Raises:
        PolicyError: it gave something that is no action.
        Exception: whatever the policy raises.
    """
    begin = time.perf_counter()
    action = policy.act(observation)
    latency = time.perf_counter() - begin
    why = refusal(action)
    if why is not None:
        raise PolicyError(f"{type(policy).__name__}.act {why}")
    return action, latency


def give_up(abort: Callable[[str], None], episode: str) -> None:
    """End an episode that cannot go on; that this fails too must not hide why."""
    with contextlib.suppress(WrongturnError):
        abort(episode)


class Waiting:
    """How long an evaluation has handed out no trial."""

    def __init__(self, evaluation: str) -> None:
        self._evaluation = evaluation
        self._since = time.monotonic()

    def ended(self) -> None:
        """A trial was had, or one is over and its place is free."""
        self._since = time.monotonic()

    def pause(self, error: NoTrialAvailableError) -> float:
        """Seconds until one may be asked for again.

        Raises:
            EvaluationStalledError: none could be had for too long.
        """
        if time.monotonic() - self._since > _STALLED_AFTER:
            raise EvaluationStalledError(
                f"no trial of evaluation {self._evaluation} could be had for {_STALLED_AFTER:.0f} s; another worker "
                "holds the rest: look at its open episodes, or resume it later by its id",
            ) from error
        return min(_PAUSE if error.retry_after is None else error.retry_after, _LONGEST_PAUSE)
