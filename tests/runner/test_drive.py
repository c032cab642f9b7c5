"""A drive by the runner, against a real service, with an agent's own token."""

import re
from pathlib import Path

import pytest
from program import SUITE, Runner, drive_of, failing
from reference_drive import reference
from small_models import not_a_number_above, wavering

from wrongturn_client import Client, LocalService
from wrongturn_protocol import EvaluationState
from wrongturn_runner.messages import DriveJob, Driven, Progressed, Refused

pytestmark = pytest.mark.usefixtures("bubblewrap")

TRIALS = 12


def results(job: DriveJob) -> dict[str, tuple[str, str]]:
    """Return verdict and trajectory's SHA-256 of each trial of a finished evaluation."""
    with Client(job.url) as client:
        found = {}
        for episode in client.finished_episodes(job.evaluation):
            assert episode.trial is not None
            assert episode.outcome is not None
            assert episode.trajectory_sha256 is not None
            assert episode.trial not in found
            found[episode.trial] = (episode.outcome.verdict.value, episode.trajectory_sha256)
        return found


def secret(job: DriveJob) -> str:
    with Client(job.url, job.token) as client:
        evaluation = client.evaluation(job.evaluation)
    assert evaluation.state is EvaluationState.FINISHED
    assert evaluation.secret is not None
    return evaluation.secret


def test_an_evaluation_is_driven_as_by_the_model_alone(tmp_path: Path, service: LocalService) -> None:
    model = wavering()
    job = drive_of(tmp_path, model, service)
    with Runner(tmp_path) as runner:
        runner.tell(job)
        *progress, last = runner.events()
        assert runner.status() == 0, runner.log
        assert not runner.log
    assert progress == [Progressed(finished=number, episodes=TRIALS) for number in range(TRIALS + 1)]
    assert isinstance(last, Driven)
    assert results(job) == reference(model, SUITE, secret(job))


def test_a_model_that_fails_in_the_middle_is_refused(tmp_path: Path, service: LocalService) -> None:
    job = drive_of(tmp_path, not_a_number_above(9.5), service)
    with Runner(tmp_path) as runner:
        runner.tell(job)
        *_, last = runner.events()
        assert runner.status() == 0, runner.log
    assert isinstance(last, Refused)
    match = re.match(r"at step (\d+) of an episode: output accelerate: is .*nan.*; it must be finite", last.reason)
    assert match, last.reason
    assert int(match[1]) > 1
    with Client(job.url, job.token) as client:
        # What becomes of them is the service's to decide.
        assert client.evaluation(job.evaluation).state is EvaluationState.RUNNING
        assert client.open_episodes(job.evaluation)


def test_an_episode_whose_state_is_gone_is_not_driven_on(tmp_path: Path, service: LocalService) -> None:
    job = drive_of(tmp_path, wavering(), service)
    with Client(job.url, job.token) as client:
        client.next_episode(job.evaluation)
    assert "its state is gone" in failing(tmp_path, job)
