"""Driving a policy through an evaluation to its end, whatever happens on the way."""

import contextlib
import platform
import threading
import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from importlib import metadata
from typing import TYPE_CHECKING

from wrongturn_client.deciding import Waiting, decide, give_up
from wrongturn_client.decoding import track_of_message
from wrongturn_client.drive import Drive
from wrongturn_client.errors import (
    EpisodeFinishedError,
    EpisodeLostError,
    EvaluationFinishedError,
    NotOfferedError,
    NoTrialAvailableError,
    ProtocolError,
    WrongturnError,
)
from wrongturn_client.evaluation_driver import EvaluationDriver
from wrongturn_client.policy import Policy
from wrongturn_client.recorder import EpisodeRecorder
from wrongturn_protocol import EpisodeRecord, EvaluationDetail, EvaluationState
from wrongturn_protocol.observations import Observation, observation_space

if TYPE_CHECKING:
    from wrongturn_client.client import Client

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all episodes."""


class _StoppedError(Exception):
    """Another thread failed, or the user has had enough; the episode stays open for later."""


@dataclass
class _Tally:
    """What the threads of one evaluation share."""

    trials: int
    finished: int
    progress: Progress | None
    records: list[EpisodeRecord] = field(default_factory=list)
    stop: threading.Event = field(default_factory=threading.Event)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, record: EpisodeRecorder | None) -> None:
        """Count an episode that is over; one without a record too."""
        with self.lock:
            if record is not None:
                self.records.append(record.message())
            self.finished += 1
            self.tell()

    def tell(self) -> None:
        """Tell the progress."""
        if self.progress is not None:
            self.progress(min(self.finished, self.trials), self.trials)


def drive_evaluation(
    client: "Client",
    policy: Policy,
    suite: str,
    *,
    evaluation: str | None = None,
    progress: Progress | None = None,
    versions: dict[str, str] | None = None,
    parallel: int = 1,
) -> EvaluationDetail:
    """See :meth:`wrongturn_client.Client.evaluate`."""
    if parallel < 1:
        raise ValueError(f"parallel: is {parallel}; drive 1 episode at a time or more")
    detail = client.create_evaluation(suite) if evaluation is None else client.evaluation(evaluation)
    if detail.suite != suite:
        raise WrongturnError(f"evaluation: {detail.id} is on the suite {detail.suite}, not on {suite}")
    if detail.state is EvaluationState.CANCELLED:
        raise WrongturnError(f"evaluation: {detail.id} was cancelled; begin a new one")
    tally = _Tally(detail.trials, detail.finished, progress)
    tally.tell()
    if detail.state is EvaluationState.RUNNING:
        resumed = [] if evaluation is None else [episode.id for episode in client.open_episodes(detail.id)]
        drive = _socket(client)
        if drive is not None:
            with drive:
                EvaluationDriver(drive, policy, detail.id, parallel=parallel, resumed=resumed, on_end=tally.add).run()
        else:
            _drive_over_http(client, policy, detail.id, tally, parallel, resumed)
    if tally.records:
        client.put_results(detail.id, tally.records, {**_versions(), **(versions or {})})
    return client.evaluation(detail.id)


def _socket(client: "Client") -> Drive | None:
    try:
        return client.drive()
    except NotOfferedError:
        return None


def _drive_over_http(
    client: "Client", policy: Policy, evaluation: str, tally: _Tally, parallel: int, resumed: list[str]
) -> None:
    for episode in resumed:
        with contextlib.suppress(EpisodeLostError):
            _resume(client, policy, episode)
            tally.add(None)
    if parallel == 1:
        _drive_trials(client, policy, evaluation, tally)
    else:
        _drive_in_threads(client, policy, evaluation, tally, parallel)


def _drive_in_threads(client: "Client", policy: Policy, evaluation: str, tally: _Tally, parallel: int) -> None:
    with ThreadPoolExecutor(parallel) as threads:
        jobs = [threads.submit(_drive_trials, client, policy, evaluation, tally) for _ in range(parallel)]
        try:
            done, _ = wait(jobs, return_when=FIRST_EXCEPTION)
        finally:  # Ctrl-C too
            tally.stop.set()
    errors = [error for job in done if (error := job.exception()) is not None]
    if errors:
        raise errors[0]


def _drive_trials(client: "Client", policy: Policy, evaluation: str, tally: _Tally) -> None:
    """Drive one trial after another until none is left."""
    waiting = Waiting(evaluation)
    while not tally.stop.is_set():
        try:
            reply = client.next_episode(evaluation)
        except EvaluationFinishedError:
            return
        except NoTrialAvailableError as error:
            time.sleep(waiting.pause(error))
            continue
        try:
            record = drive_episode(client, policy, reply.id, 0, reply.observation, stop=tally.stop)
        except EpisodeLostError:
            continue
        except _StoppedError:
            return
        waiting.ended()
        tally.add(record)


def drive_episode(
    client: "Client",
    policy: Policy,
    episode: str,
    seq: int,
    observation: Observation,
    *,
    stop: threading.Event | None = None,
) -> EpisodeRecorder:
    """Drive one episode to its end.

    Args:
        client: the connection.
        policy: what decides.
        episode: its id.
        seq: of the last reply.
        observation: of the last reply.
        stop: leaves the episode as it is once it is set.

    Returns:
        What was done from here on.

    Raises:
        EpisodeLostError: the service was started again meanwhile.
        PolicyError: the policy gave something that is no action; the episode is aborted then, as for any error that
            the policy raises itself.
    """
    record = EpisodeRecorder(episode)
    try:
        policy.reset(observation_space(track_of_message(observation)))
    except Exception:
        give_up(client.abort_episode, episode)
        raise
    while True:
        if stop is not None and stop.is_set():
            raise _StoppedError
        try:
            action, latency = decide(policy, observation)
        except Exception:
            give_up(client.abort_episode, episode)
            raise
        seq += 1
        record.add(action, latency)
        reply = client.step(episode, seq, action)
        if reply.seq != seq:
            raise ProtocolError(f"seq: the reply to step {seq} of episode {episode} has {reply.seq}")
        if reply.terminated or reply.truncated:
            return record
        observation = reply.observation


def _resume(client: "Client", policy: Policy, episode: str) -> None:
    """Go on with an episode from its last reply; without a record, as its first actions are not known here."""
    detail = client.episode(episode)
    last = detail.last_reply
    if last is None:  # ended meanwhile
        return
    with contextlib.suppress(EpisodeFinishedError):
        drive_episode(client, policy, episode, int(last["seq"]), last["observation"])


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in ("wrongturn-client", "wrongturn-agents", "numpy"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions
