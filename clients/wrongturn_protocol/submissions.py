"""Messages of submissions: agents that are handed in as a model, which the service drives itself."""

from typing import Final

from pydantic import Field

from wrongturn_protocol.episodes import Message, is_none
from wrongturn_protocol.vocabulary import SubmissionState, Track

MODEL: Final = "model"
"""Name of the multipart field with the model's bytes."""
SUITE: Final = "suite"
"""Name of the multipart field with the suite's id."""
NAME: Final = "name"
"""Name of the multipart field with the agent's name."""


class SubmissionDetail(Message):
    """``GET /v1/submissions/{id}``, and the reply 202 to ``POST /v1/submissions``."""

    id: str
    state: SubmissionState
    suite: str
    name: str
    """Name of the agent."""
    owner: str
    """Name of the owner."""
    sha256: str
    """SHA-256 of the model."""
    size: int
    """Bytes of the model."""
    created: str
    """When it was handed in, ISO 8601 in UTC."""
    position: int | None = Field(default=None, exclude_if=is_none)
    """While it waits: how many submissions are driven before it at the latest. 0 is the next one."""
    track: Track | None = Field(default=None, exclude_if=is_none)
    """Track of the agent, once the model is checked."""
    agent: str | None = Field(default=None, exclude_if=is_none)
    """Id of the agent, once the model is checked."""
    evaluation: str | None = Field(default=None, exclude_if=is_none)
    """Id of the evaluation, once it runs."""
    finished: int | None = Field(default=None, exclude_if=is_none)
    """Episodes that were driven to their end, once it runs. Those that a closing aborts are not among them."""
    episodes: int | None = Field(default=None, exclude_if=is_none)
    """All episodes of the evaluation, once it runs."""
    reason: str | None = Field(default=None, exclude_if=is_none)
    """Why it failed or was cancelled, and what to do."""


class SubmissionList(Message):
    """``GET /v1/submissions``: those of the caller, newest first."""

    submissions: tuple[SubmissionDetail, ...]
    next: str | None = None
    """Cursor of the next page; None at the end."""


class SubmissionLogLine(Message):
    """One line of a submission's log."""

    time: str
    """ISO 8601 in UTC."""
    message: str


class SubmissionLog(Message):
    """``GET /v1/submissions/{id}/log``: what happened so far, oldest first."""

    lines: tuple[SubmissionLogLine, ...]
