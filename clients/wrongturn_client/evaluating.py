"""Evaluating: begin or resume an evaluation, drive all its trials, post the record and check the result."""

import contextlib
import hashlib
import platform
import sys
from importlib import metadata
from typing import TYPE_CHECKING, Final

from wrongturn_client.errors import CommitmentError, EvaluationOpenError, WrongturnError
from wrongturn_client.evaluation import Evaluation, keep
from wrongturn_client.evaluation_driver import EpisodeRecorder, EvaluationDriver
from wrongturn_client.policy import Policy, PolicyMaker, maker_of
from wrongturn_client.transport import Progress
from wrongturn_protocol import EpisodeRecord, EvaluationState

if TYPE_CHECKING:
    from wrongturn_client.client import Client

_CONNECTIONS: Final = 32
"""Most connections for driving that a service gives one agent by default."""
_WIDTH: Final = 30
"""Characters of the bar."""


def evaluate(
    client: "Client",
    policy: Policy | PolicyMaker,
    suite: str,
    *,
    evaluation: str | None,
    progress: Progress | bool | None,
    versions: dict[str, str] | None,
    parallel: int,
) -> Evaluation:
    """Drive a policy through all trials of a suite, as :meth:`wrongturn_client.Client.evaluate` describes."""
    if parallel < 1:
        raise ValueError(f"parallel: is {parallel}; drive 1 episode at a time or more")
    make_policy = maker_of(policy)
    tell = _teller(progress, suite)
    begun, resumed = _begin(client, suite, evaluation)
    records: list[EpisodeRecord] = []
    finished = begun.finished

    def count(recorder: EpisodeRecorder | None) -> None:
        nonlocal finished
        finished += 1
        if recorder is not None:
            records.append(recorder.record())
        tell(min(finished, begun.trials), begun.trials)

    tell(min(finished, begun.trials), begun.trials)
    if begun.state is EvaluationState.RUNNING:
        episodes = [episode.id for episode in client.open_episodes(begun.id)] if resumed else []
        driver = EvaluationDriver(lambda: client.connection(1), make_policy, begun.id, resumed=episodes, on_end=count)
        driver.run(min(parallel, begun.max_parallel, _CONNECTIONS))
    if records:
        client.put_results(begun.id, records, {**_installed_versions(), **(versions or {})})
    done = client.evaluation(begun.id)
    _check_commitment(begun, done)
    keep(done, client.finished_episodes(done.id))
    return done


def _begin(client: "Client", suite: str, evaluation: str | None) -> tuple[Evaluation, bool]:
    """Return the evaluation to drive: a new one, or the open one of this id or on this suite; and whether it was open.

    Raises:
        WrongturnError: It is on another suite, or was cancelled.
    """
    if evaluation is None:
        try:
            return client.create_evaluation(suite), False
        except EvaluationOpenError as error:
            if not error.evaluation:
                raise
            evaluation = error.evaluation
    found = client.evaluation(evaluation)
    if found.suite != suite:
        raise WrongturnError(f"evaluation: {found.id} is on the suite {found.suite}, not on {suite}")
    if found.state is EvaluationState.CANCELLED:
        raise WrongturnError(f"evaluation: {found.id} was cancelled; begin a new one")
    return found, True


def _teller(progress: Progress | bool | None, name: str) -> Progress:
    """Return what shows the progress of an evaluation of this name, as it was asked for."""
    if progress is None or progress is False:
        return lambda finished, total: None  # noqa: ARG005
    if progress is not True:
        if not callable(progress):
            raise TypeError(f"progress: is {progress!r}; give True, or a function of two numbers")
        return progress

    def show(finished: int, total: int) -> None:
        full = _WIDTH * finished // max(total, 1)
        bar = "#" * full + "." * (_WIDTH - full)
        end = "\n" if finished >= total else ""
        # A carriage return is all that both terminals and notebooks understand.
        print(f"\r{name}: [{bar}] {finished} of {total} episodes", end=end, file=sys.stderr, flush=True)

    return show


def _installed_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that influence a result."""
    versions = {"python": platform.python_version()}
    for name in ("wrongturn-client", "wrongturn-agents", "numpy"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def _check_commitment(begun: Evaluation, done: Evaluation) -> None:
    """Raise CommitmentError if the service did not draw the trials before it saw the agent drive.

    A finished evaluation's secret then is not the one that was promised at its beginning.
    """
    if done.state is not EvaluationState.FINISHED or begun.commitment is None:
        return
    told = None if done.secret is None else hashlib.sha256(done.secret.encode()).hexdigest()
    if told != begun.commitment:
        raise CommitmentError(
            f"evaluation {done.id}: the service promised a secret with the SHA-256 {begun.commitment} and told "
            f"{'none' if told is None else f'one with {told}'}; the trials may have been chosen afterwards, so do not "
            "trust the result, and ask the operator"
        )
