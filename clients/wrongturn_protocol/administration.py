"""Messages of the operator's calls under ``/v1/admin``: lists, deletions, usage and the audit log."""

from typing import Literal

from pydantic import Field

from wrongturn_protocol.episodes import Message, is_none
from wrongturn_protocol.vocabulary import AgentKind, AuditAction, Collection, Track

AuditKind = Collection | Literal["keys"]
"""What the operator changes: one of a collection, or the key that signs certificates."""


class AdminItem(Message):
    """An owner, an agent, an evaluation or a submission as the operator sees it. What it does not have is left out."""

    id: str
    name: str
    """Name of the owner or the agent. Evaluations and submissions have their agent's."""
    created: str
    """ISO 8601 in UTC."""
    owner: str | None = Field(default=None, exclude_if=is_none)
    """Id of the owner; not of owners."""
    agent: str | None = Field(default=None, exclude_if=is_none)
    """Id of the agent, of evaluations and of submissions that have one."""
    evaluation: str | None = Field(default=None, exclude_if=is_none)
    """Id of the evaluation, of submissions that have one."""
    hidden: bool | None = Field(default=None, exclude_if=is_none)
    """Whether the operator hides it. Submissions are never public."""
    token: bool | None = Field(default=None, exclude_if=is_none)
    """Whether it has a valid token; of owners and agents."""
    contact: str | None = Field(default=None, exclude_if=is_none)
    """How to reach the owner. Only the operator sees it."""
    track: Track | None = Field(default=None, exclude_if=is_none)
    kind: AgentKind | None = Field(default=None, exclude_if=is_none)
    suite: str | None = Field(default=None, exclude_if=is_none)
    state: str | None = Field(default=None, exclude_if=is_none)
    """State of the evaluation or the submission."""
    reason: str | None = Field(default=None, exclude_if=is_none)
    """Why the submission failed or was cancelled."""


class AdminList(Message):
    """``GET /v1/admin/{collection}``: one page."""

    items: tuple[AdminItem, ...]
    next: str | None = None
    """Cursor of the next page. None on the last one."""


class Contents(Message):
    """What hangs on something, or was deleted with it: numbers of each kind, with the thing itself."""

    owners: int = 0
    agents: int = 0
    evaluations: int = 0
    episodes: int = 0
    trajectories: int = 0
    results: int = 0
    """Workers' own records."""
    submissions: int = 0
    models: int = 0
    """Files with models."""
    replies: int = 0
    """Stored replies to ``Idempotency-Key``."""
    bytes: int = 0
    """Stored bytes of all these."""


class AdminDetail(AdminItem):
    """``GET /v1/admin/{collection}/{item}``: also what a deletion would delete."""

    contents: Contents


class Change(Message):
    """Reply to a call that hides, shows again, or ends tokens."""

    id: str
    changed: int
    """How many flags or tokens were changed. 0 if it was so before."""


class Deletion(Message):
    """Reply to ``DELETE /v1/admin/{collection}/{item}``."""

    id: str
    name: str
    deleted: Contents
    """What was deleted now. A repeat deletes nothing more."""
    held: tuple[str, ...] = ()
    """What stays taken: names, and places on suites. Empty if the operator frees them."""


class OwnerUsage(Message):
    """What an owner has stored."""

    id: str
    name: str
    contents: Contents


class UsageList(Message):
    """``GET /v1/admin/usage``: one page of the owners, those with the most bytes first."""

    owners: tuple[OwnerUsage, ...]
    total: Contents
    """The sum over all owners."""
    next: str | None = None
    """Cursor of the next page. None on the last one."""


class AuditEntry(Message):
    """What the operator did once."""

    seq: int
    time: str
    """ISO 8601 in UTC."""
    actor: str
    """``operator``, and the first digits of the SHA-256 of the token that was sent."""
    address: str
    """Where the call came from."""
    action: AuditAction
    collection: AuditKind
    target: str
    """Id of the target, which may be deleted."""
    name: str
    """Name that the target had."""
    reason: str | None = Field(default=None, exclude_if=is_none)
    """Why, as the operator said."""
    contents: Contents
    """How many of each kind were changed or deleted."""


class AuditList(Message):
    """``GET /v1/admin/audit``: one page, newest first."""

    entries: tuple[AuditEntry, ...]
    next: str | None = None
    """Cursor of the next page. None on the last one."""
