"""Checking a model: it loads, keeps the contract, and drives a few steps of practice."""

import contextlib
from typing import Final

from wrongturn_client import Client, WrongturnError
from wrongturn_protocol import EpisodeReply, PracticeRequest
from wrongturn_protocol.observations import observation_space
from wrongturn_runner.conversation import Conversation
from wrongturn_runner.messages import Check, Described, Passed
from wrongturn_runner.model import EpisodePolicy, sandboxed_model
from wrongturn_runner.pace import CHECK_DEADLINE_S, CHECK_STEP_S, Pace

STEPS: Final = 6
"""Steps of practice."""


class _TimedPace(Pace):
    """Pace that keeps the time of each step."""

    def __init__(self) -> None:
        super().__init__(CHECK_STEP_S, STEPS)
        self.steps_ms: list[float] = []

    def add(self, seconds: float) -> None:
        """Add a step; raise as :meth:`Pace.add`."""
        self.steps_ms.append(round(seconds * 1000, 2))
        super().add(seconds)


def check(job: Check, conversation: Conversation) -> Passed:
    """Check a model.

    Raises:
        ModelAtFaultError: The model cannot be driven.
        RunnerFailedError: There is no sandbox, or it is lost.
        WrongturnError: The service refuses, or cannot be reached.
    """
    pace = _TimedPace()
    with sandboxed_model(job, step_s=CHECK_DEADLINE_S, tracks=job.tracks, agent_track=job.agent_track) as model:
        conversation.tell(
            Described(
                track=model.contract.track,
                description=model.description,
                about=model.about,
                trained_on_faults=model.trained_on_faults,
            )
        )
        practice = conversation.practice()
        with Client(job.url, practice.token) as client:
            begun = client.practise(PracticeRequest(suite=practice.suite, trial=practice.trial))
            try:
                policy = EpisodePolicy(model, pace)
                policy.reset(observation_space(model.contract.track))
                _drive_steps(client, policy, begun)
            finally:
                # Otherwise it keeps a simulator from others until its lease ends.
                with contextlib.suppress(WrongturnError):
                    client.abort_episode(begun.id)
    return Passed(step_ms=tuple(pace.steps_ms))


def _drive_steps(client: Client, policy: EpisodePolicy, begun: EpisodeReply) -> None:
    observation = begun.observation
    for seq in range(1, STEPS + 1):
        reply = client.step(begun.id, seq, policy.act(observation))
        if reply.terminated or reply.truncated:
            return
        observation = reply.observation
