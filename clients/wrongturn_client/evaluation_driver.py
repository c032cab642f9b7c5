"""Driving a policy through the trials of an evaluation, over the WebSocket or HTTP."""

import contextlib
import hashlib
import statistics
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final

from wrongturn_client.episode_calls import (
    DriveConnection,
    EpisodeCall,
    EpisodeCalls,
    Result,
    action_of,
    granted,
    next_call,
    step_call,
    track_of_message,
)
from wrongturn_client.errors import (
    EpisodeFinishedError,
    EpisodeLostError,
    EvaluationFinishedError,
    EvaluationStalledError,
    InvalidActionError,
    NoTrialAvailableError,
    PolicyError,
    ProtocolError,
    WrongturnError,
)
from wrongturn_client.policy import Policy, PolicyMaker
from wrongturn_protocol import Action, EpisodeRecord, EpisodeReply
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_protocol.wire import CALLS, Call

_STALLED_AFTER: Final = 900.0
"""Seconds without a trial; the service gives up on a vanished worker after 600."""
_PAUSE: Final = 1.0
"""Seconds, if the service does not say when to ask for a trial again."""
_LONGEST_PAUSE: Final = 10.0
_ACTION: Final = struct.Struct("<3f")

_Map = Callable[[Callable[["_OpenEpisode"], None], "list[_OpenEpisode]"], Iterable[None]]
"""``map``, or its counterpart in threads if several episodes are driven at a time."""


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


@dataclass
class _OpenEpisode:
    id: str
    seq: int
    observation: Observation
    recorder: EpisodeRecorder | None
    """None for a resumed episode: its first actions are not known here."""
    policy: Policy
    call: EpisodeCall = ()
    """That of the step under way."""


class EvaluationDriver:
    """Drives one policy through one evaluation.

    The steps of all open episodes go in one message. Each request for a new trial has a message of its own, because a
    reset takes as long as dozens of steps.
    """

    def __init__(
        self,
        connection: DriveConnection,
        make_policy: PolicyMaker,
        evaluation: str,
        *,
        parallel: int,
        resumed: Iterable[str] = (),
        on_end: Callable[[EpisodeRecorder | None], None],
    ) -> None:
        """Create a driver without episodes; ``on_end`` gets the record of each ended one, None for a resumed one."""
        self._connection = connection
        self._make_policy = make_policy
        self._evaluation = evaluation
        self._parallel = min(parallel, CALLS // 2)
        self._resumed = deque(resumed)
        self._on_end = on_end
        self._asked: dict[int, EpisodeCall] = {}
        """Calls that begin or resume an episode, by the number of their message."""
        self._stepping: dict[int, list[_OpenEpisode]] = {}
        self._ready: list[_OpenEpisode] = []
        self._no_trial_left = False
        self._ask_at = 0.0
        self._last_progress = time.monotonic()

    def run(self) -> None:
        """Drive until no trial is left; raise as :meth:`wrongturn_client.Client.evaluate`."""
        with contextlib.ExitStack() as stack:
            each: _Map = map if self._parallel == 1 else stack.enter_context(ThreadPoolExecutor(self._parallel)).map
            while True:
                self._ask()
                if self._ready and not self._stepping:
                    self._step(each)
                if self._asked or self._stepping:
                    self._take(*self._connection.receive())
                elif self._no_trial_left and not self._resumed:
                    return
                else:
                    time.sleep(max(0.0, self._ask_at - time.monotonic()))

    def _ask(self) -> None:
        """Ask for as many trials as there is room for."""
        room = self._parallel - len(self._asked) - len(self._ready) - sum(map(len, self._stepping.values()))
        for _ in range(room):
            if self._resumed:
                call = [Call.LOOK.value, self._resumed.popleft()]
            elif self._no_trial_left or time.monotonic() < self._ask_at:
                return
            else:
                call = next_call(self._evaluation)
            self._asked[self._connection.submit([call])] = call

    def _step(self, each: _Map) -> None:
        episodes, self._ready = self._ready, []
        list(each(self._decide, episodes))
        self._stepping[self._connection.submit([episode.call for episode in episodes])] = episodes

    def _decide(self, episode: _OpenEpisode) -> None:
        action, latency = _decide(self._connection, episode.policy, episode.id, episode.observation)
        episode.call = step_call(episode.id, episode.seq + 1, action)
        if episode.recorder is not None:
            episode.recorder.add(action, latency)

    def _take(self, number: int, results: list[Result]) -> None:
        call = self._asked.pop(number, None)
        if call is not None:
            self._connection.retry_busy([call], results)
            self._begin(call, results[0])
            return
        episodes = self._stepping.pop(number)
        self._connection.retry_busy([episode.call for episode in episodes], results)
        for episode, result in zip(episodes, results, strict=True):
            self._advance(episode, result)

    def _begin(self, call: EpisodeCall, result: Result) -> None:
        if isinstance(result, EvaluationFinishedError):
            self._no_trial_left = True
        elif isinstance(result, NoTrialAvailableError):
            self._ask_at = time.monotonic() + self._pause(result)
        elif isinstance(result, EpisodeLostError):
            return
        elif call[0] != Call.LOOK:
            fields = granted(result)
            self._start(fields["id"], 0, fields["observation"], EpisodeRecorder(fields["id"]))
        elif last := granted(result).get("last_reply"):  # without one, the episode has ended meanwhile
            self._start(granted(result)["id"], int(last["seq"]), last["observation"], None)

    def _pause(self, error: NoTrialAvailableError) -> float:
        """Return the seconds until the next attempt to get a trial."""
        if time.monotonic() - self._last_progress > _STALLED_AFTER:
            raise EvaluationStalledError(
                f"the service handed out no trial of evaluation {self._evaluation} for {_STALLED_AFTER:.0f} s; another "
                "worker holds the rest: look at the open episodes, or resume the evaluation later by its id"
            ) from error
        return min(_PAUSE if error.retry_after is None else error.retry_after, _LONGEST_PAUSE)

    def _start(self, name: str, seq: int, observation: Observation, recorder: EpisodeRecorder | None) -> None:
        self._last_progress = time.monotonic()
        policy = self._make_policy()
        _reset(self._connection, policy, name, observation)
        self._ready.append(_OpenEpisode(name, seq, observation, recorder, policy))

    def _advance(self, episode: _OpenEpisode, result: Result) -> None:
        if isinstance(result, EpisodeLostError):
            return
        if isinstance(result, EpisodeFinishedError) and episode.recorder is None:
            self._end(episode)
            return
        fields = granted(result)
        _check_seq(episode.id, episode.seq + 1, fields["seq"])
        if fields["terminated"] or fields["truncated"]:
            self._end(episode)
            return
        episode.seq += 1
        episode.observation = fields["observation"]
        self._ready.append(episode)

    def _end(self, episode: _OpenEpisode) -> None:
        # There is room for a trial again, and perhaps a twin is free: ask at once.
        self._ask_at = 0.0
        self._last_progress = time.monotonic()
        self._on_end(episode.recorder)


def drive_episode(
    client: EpisodeCalls, policy: Policy, begun: EpisodeReply, *, stop: threading.Event | None = None
) -> None:
    """Drive one episode to its end.

    Args:
        client: Carries the calls.
        policy: Decides on the actions.
        begun: The reply to the reset.
        stop: Once set, the episode is left open where it is.

    Raises:
        EpisodeLostError: The service was restarted meanwhile.
        PolicyError: The policy returned something that is not an action. The episode is aborted then, as after any
            error that the policy raises.
    """
    seq, observation = 0, begun.observation
    _reset(client, policy, begun.id, observation)
    while stop is None or not stop.is_set():
        action, _ = _decide(client, policy, begun.id, observation)
        seq += 1
        reply = client.step(begun.id, seq, action)
        _check_seq(begun.id, seq, reply.seq)
        if reply.terminated or reply.truncated:
            return
        observation = reply.observation


def _reset(client: EpisodeCalls, policy: Policy, episode: str, observation: Observation) -> None:
    """Reset the policy; if that fails, abort the episode."""
    try:
        policy.reset(observation_space(track_of_message(observation)))
    except Exception:
        _abort(client, episode)
        raise


def _decide(client: EpisodeCalls, policy: Policy, episode: str, observation: Observation) -> tuple[Action, float]:
    """Return the policy's action and the seconds it took; if that fails, abort the episode."""
    try:
        begin = time.perf_counter()
        given = policy.act(observation)
        latency = time.perf_counter() - begin
        return action_of(given), latency
    except Exception as error:
        _abort(client, episode)
        if isinstance(error, InvalidActionError):
            called = f"{type(policy).__name__}.act"
            raise PolicyError(f"{called} returned no action that can be driven: {error}") from None
        raise


def _abort(client: EpisodeCalls, episode: str) -> None:
    with contextlib.suppress(WrongturnError):  # the first error matters more
        client.abort_episode(episode)


def _check_seq(episode: str, wanted: int, got: int) -> None:
    if got != wanted:
        raise ProtocolError(f"seq: the reply to step {wanted} of episode {episode} has {got}")
