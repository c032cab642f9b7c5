"""Driving an evaluation with a model, through the service's own calls."""

from typing import Final

from wrongturn_client import Client
from wrongturn_protocol import EvaluationState
from wrongturn_runner.conversation import Conversation
from wrongturn_runner.errors import RunnerFailedError
from wrongturn_runner.messages import Drive, Driven, Progressed
from wrongturn_runner.model import EpisodePolicy, sandboxed_model
from wrongturn_runner.pace import DRIVE_DEADLINE_S, DRIVE_STEP_S, Pace

EPISODES: Final = 2
"""Episodes at a time. A submission gets about two processors, as ``WRONGTURN_SUBMISSIONS`` has it by default."""
SANDBOXES: Final = 2
"""Sandboxes of a submission, so that two episodes do not wait for each other."""


def drive(job: Drive, conversation: Conversation) -> Driven:
    """Drive an evaluation to its end, from wherever it is.

    Each observation goes to the model alone, so what it answers does not depend on the other episodes.

    Raises:
        ModelAtFaultError: The model cannot be driven.
        RunnerFailedError: There is no sandbox, or it is lost; or the evaluation cannot be finished.
        WrongturnError: The service refuses, or cannot be reached.
    """
    with (
        sandboxed_model(job, step_s=DRIVE_DEADLINE_S, sandboxes=SANDBOXES) as model,
        Client(job.url, job.token) as client,
    ):
        if model.contract.state_shape is not None and client.open_episodes(job.evaluation):
            raise RunnerFailedError("an episode is open that another runner began, and its state is gone")
        pace = Pace(DRIVE_STEP_S)
        evaluation = client.evaluate(
            lambda: EpisodePolicy(model, pace),
            job.suite,
            evaluation=job.evaluation,
            parallel=EPISODES,
            progress=lambda finished, episodes: conversation.tell(Progressed(finished=finished, episodes=episodes)),
        )
    if evaluation.state is not EvaluationState.FINISHED:
        raise RunnerFailedError(f"no trial is left, but the evaluation is {evaluation.state}")
    return Driven()
