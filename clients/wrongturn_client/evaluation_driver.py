"""Driving a policy through the trials of an evaluation."""

import contextlib
import hashlib
import statistics
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Final

from wrongturn_client.episode_calls import EpisodeCalls, sight_of_policy
from wrongturn_client.errors import (
    EpisodeFinishedError,
    EpisodeLostError,
    EvaluationFinishedError,
    EvaluationStalledError,
    NoTrialAvailableError,
    PolicyError,
    ProtocolError,
    ServiceBusyError,
    TownsNotBuiltError,
    WrongturnError,
)
from wrongturn_client.policy import Policy, PolicyMaker
from wrongturn_protocol import Action, EpisodeRecord, EpisodeReply
from wrongturn_protocol.answers import driver_of
from wrongturn_protocol.episodes import ActionError
from wrongturn_protocol.observations import Observation, observation_space

_STALLED_AFTER: Final = 900.0
"""Seconds without a trial; the service gives up on a vanished worker after 600."""
_PAUSE: Final = 1.0
"""Seconds, if the service does not say when to ask for a trial again."""
_LONGEST_PAUSE: Final = 10.0
_ACTION: Final = struct.Struct("<3f")


@dataclass
class EpisodeRecorder:
    """Collects what the worker did in one episode."""

    episode: str
    latencies: list[float] = field(default_factory=list)
    """Seconds that each decision took."""
    actions: bytearray = field(default_factory=bytearray)
    """Little-endian float32 [n, 3]."""

    def add(self, action: Action, latency: float) -> None:
        """Add a decision and the seconds it took."""
        self.latencies.append(latency)
        self.actions += _ACTION.pack(action.steer, action.throttle, action.brake)

    def record(self) -> EpisodeRecord:
        """Return the record that is posted to the service."""
        return EpisodeRecord(
            episode=self.episode,
            steps=len(self.latencies),
            actions_sha256=hashlib.sha256(self.actions).hexdigest(),
            latency_ms=statistics.median(self.latencies) * 1000 if self.latencies else None,
        )


class EvaluationDriver:
    """Drives policies through the trials of one evaluation. Each episode at a time has a thread and a connection."""

    def __init__(
        self,
        connect: Callable[[], EpisodeCalls],
        make_policy: PolicyMaker,
        evaluation: str,
        *,
        resumed: Iterable[str] = (),
        on_end: Callable[[EpisodeRecorder | None], None],
    ) -> None:
        """Create a driver without episodes; ``on_end`` gets the record of each ended one, None for a resumed one."""
        self._connect = connect
        self._make_policy = make_policy
        self._evaluation = evaluation
        self._resumed = deque(resumed)
        self._on_end = on_end
        self._stop = threading.Event()
        self._changed = threading.Condition()
        """Notified when an episode ended: there is room for another, and perhaps its twin is free."""
        self._ended = 0
        self._refused: list[ServiceBusyError] = []
        """Of threads that got no connection; they leave their trials to the others."""
        self._last_progress = time.monotonic()

    def run(self, parallel: int) -> None:
        """Drive until no trial is left, so many episodes at a time; raises as :meth:`Client.evaluate`.

        After an error the other episodes stay open where they are.
        """
        if parallel == 1:
            self._work()
        else:
            self._work_in_threads(parallel)
        if len(self._refused) == parallel:
            raise self._refused[0]

    def _work_in_threads(self, parallel: int) -> None:
        with ThreadPoolExecutor(parallel, "wrongturn-evaluation") as threads:
            jobs = [threads.submit(self._work) for _ in range(parallel)]
            try:
                done, _ = wait(jobs, return_when=FIRST_EXCEPTION)
            finally:  # after Ctrl-C too
                self._stop.set()
                with self._changed:
                    self._changed.notify_all()
        for job in done:
            job.result()

    def _work(self) -> None:
        try:
            connection = self._connect()
        except ServiceBusyError as error:  # the agent has as many connections as it may
            self._refused.append(error)
            return
        with connection as calls:
            while self._resumed and not self._stop.is_set():
                with contextlib.suppress(IndexError, EpisodeLostError):
                    found = calls.episode(self._resumed.popleft())
                    if last := found.last_reply:  # without one, the episode has ended meanwhile
                        self._drive(calls, found.id, int(last["seq"]), last["observation"], None)
            while (begun := self._next_episode(calls)) is not None:
                self._drive(calls, begun.id, 0, begun.observation, EpisodeRecorder(begun.id))

    def _next_episode(self, calls: EpisodeCalls) -> EpisodeReply | None:
        """Begin the next trial, once one is free; return None if none is left."""
        while not self._stop.is_set():
            ended = self._ended
            try:
                return calls.next_episode(self._evaluation)
            except EvaluationFinishedError:
                return None
            except (NoTrialAvailableError, TownsNotBuiltError) as error:
                self._await_trial(error, ended)
        return None

    def _await_trial(self, error: NoTrialAvailableError | TownsNotBuiltError, ended: int) -> None:
        if time.monotonic() - self._last_progress > _STALLED_AFTER:
            raise EvaluationStalledError(
                f"the service handed out no trial of evaluation {self._evaluation} for {_STALLED_AFTER:.0f} s; another "
                "worker holds the rest: look at the open episodes, or resume the evaluation later by its id"
            ) from error
        pause = min(_PAUSE if error.retry_after is None else error.retry_after, _LONGEST_PAUSE)
        with self._changed:
            self._changed.wait_for(lambda: self._ended != ended or self._stop.is_set(), pause)

    def _drive(
        self, calls: EpisodeCalls, episode: str, seq: int, observation: Observation, recorder: EpisodeRecorder | None
    ) -> None:
        with self._changed:
            self._last_progress = time.monotonic()
            policy = self._make_policy()
        try:
            if not _driven(calls, policy, episode, seq, observation, recorder, self._stop):
                return
        except EpisodeLostError:
            return  # its trial is handed out again
        except EpisodeFinishedError:
            if recorder is not None:
                raise
        with self._changed:
            self._ended += 1
            self._last_progress = time.monotonic()
            self._on_end(recorder)
            self._changed.notify_all()


def drive_episode(
    client: EpisodeCalls, policy: Policy, begun: EpisodeReply, *, stop: threading.Event | None = None
) -> None:
    """Drive one episode from the reply to its reset to its end. Once ``stop`` is set, it is left open where it is.

    Raises:
        EpisodeLostError: The service was restarted meanwhile.
        PolicyError: The policy returned something that is not an action. The episode is aborted then, as after any
            error that the policy raises.
    """
    _driven(client, policy, begun.id, 0, begun.observation, None, stop)


def _driven(
    calls: EpisodeCalls,
    policy: Policy,
    episode: str,
    seq: int,
    observation: Observation,
    recorder: EpisodeRecorder | None,
    stop: threading.Event | None,
) -> bool:
    """Drive an episode on from its last reply; return whether it ended, and not only was stopped."""
    with _aborting(calls, episode):
        sight = sight_of_policy(policy, observation)
        policy.reset(observation_space(sight))
        control = driver_of(sight)
    while stop is None or not stop.is_set():
        with _aborting(calls, episode):
            begin = time.perf_counter()
            given = policy.act(observation)
            latency = time.perf_counter() - begin
            try:
                action = control(given, observation)
            except ActionError as error:
                named = type(policy).__name__
                raise PolicyError(f"{named}.act returned no action that can be driven: {error}") from None
        if recorder is not None:
            recorder.add(action, latency)
        seq += 1
        reply = calls.step(episode, seq, action)
        if reply.seq != seq:
            raise ProtocolError(f"seq: the reply to step {seq} of episode {episode} has {reply.seq}")
        if reply.terminated or reply.truncated:
            return True
        observation = reply.observation
    return False


@contextlib.contextmanager
def _aborting(calls: EpisodeCalls, episode: str) -> Iterator[None]:
    """Abort the episode if the policy fails."""
    try:
        yield
    except Exception:
        with contextlib.suppress(WrongturnError):  # the first error matters more
            calls.abort_episode(episode)
        raise
