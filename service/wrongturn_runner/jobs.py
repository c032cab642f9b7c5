"""The two jobs of a runner: to check a model, and to drive an evaluation with it through the service's own calls."""

import contextlib
from typing import Final

from wrongturn_client import Client, WrongturnError
from wrongturn_protocol import EvaluationState, PracticeRequest
from wrongturn_protocol.answers import driver_of
from wrongturn_protocol.observations import observation_space
from wrongturn_runner import SANDBOXES, pace
from wrongturn_runner.conversation import Conversation, RunnerFailedError
from wrongturn_runner.messages import PRACTICE, CheckJob, Described, DriveJob, Driven, Passed, Progressed
from wrongturn_runner.model import EpisodePolicy, sandboxed_model

STEPS: Final = 6
"""Steps of practice."""
EPISODES: Final = 2
"""Episodes at a time. A submission gets about two processors, as ``WRONGTURN_SUBMISSIONS`` has it by default."""


def check(job: CheckJob, conversation: Conversation) -> Passed:
    """Check a model: it loads, keeps the contract, and drives a few steps of practice.

    Raises ModelAtFaultError, RunnerFailedError, and WrongturnError if the service refuses or cannot be reached.
    """
    kept = pace.Pace(pace.CHECK_STEP_S, STEPS)
    with sandboxed_model(
        job,
        step_s=pace.CHECK_DEADLINE_S,
        life_s=pace.CHECK_LIFE_S,
        tracks=job.tracks,
        agent_track=job.agent_track,
        agent_rig=job.agent_rig,
    ) as model:
        conversation.tell(
            Described(
                track=model.contract.track,
                description=model.description,
                about=model.about,
                trained_on_faults=model.contract.trained_on_faults,
                rig=model.contract.rig,
            )
        )
        practice = conversation.read(PRACTICE)
        with Client(job.url, practice.token, timeout=pace.REPLY_S, patience=pace.PATIENCE_S) as client:
            begun = client.practise(PracticeRequest(suite=practice.suite, trial=practice.trial))
            try:
                policy = EpisodePolicy(model, kept)
                policy.reset(observation_space(model.contract.sight))
                control = driver_of(model.contract.sight)
                observation = begun.observation
                for seq in range(1, STEPS + 1):
                    reply = client.step(begun.id, seq, control(policy.act(observation), observation))
                    if reply.terminated or reply.truncated:
                        break
                    observation = reply.observation
            finally:
                # Otherwise it keeps a simulator from others until its lease ends.
                with contextlib.suppress(WrongturnError):
                    client.abort_episode(begun.id)
    return Passed(step_ms=tuple(round(seconds * 1000, 2) for seconds in kept.steps_s))


def drive(job: DriveJob, conversation: Conversation) -> Driven:
    """Drive an evaluation to its end, from wherever it is.

    Each observation goes to the model alone, so what it answers does not depend on the other episodes. Raises as
    :func:`check`, and RunnerFailedError if the evaluation cannot be finished.
    """
    with (
        sandboxed_model(job, step_s=pace.DRIVE_DEADLINE_S, life_s=pace.DRIVE_LIFE_S, sandboxes=SANDBOXES) as model,
        Client(job.url, job.token, timeout=pace.REPLY_S, patience=pace.PATIENCE_S) as client,
    ):
        if model.contract.state_shape is not None and client.open_episodes(job.evaluation):
            raise RunnerFailedError("an episode is open that another runner began, and its state is gone")
        kept = pace.Pace(pace.DRIVE_STEP_S)
        evaluation = client.evaluate(
            lambda: EpisodePolicy(model, kept),
            job.suite,
            evaluation=job.evaluation,
            parallel=EPISODES,
            progress=lambda finished, episodes: conversation.tell(Progressed(finished=finished, episodes=episodes)),
        )
    if evaluation.state is not EvaluationState.FINISHED:
        raise RunnerFailedError(f"no trial is left, but the evaluation is {evaluation.state}")
    return Driven()
