"""Submissions in the database: their order, their states, their agents and their logs."""

import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from wrongturn_protocol import SubmissionState
from wrongturn_service.registration import new_owner
from wrongturn_service.storage.accounts import AgentNameTakenError
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.models import AgentRow, EvaluationRow, SubmissionRow
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.submissions import SubmissionStore


@contextlib.asynccontextmanager
async def opened(url: str) -> AsyncIterator[tuple[Store, SubmissionStore]]:
    """A database with the owners ow_a and ow_b."""
    database = await Database.open(url)
    store = Store(database)
    for name in ("a", "b"):
        owner = new_owner(name)
        owner.id = f"ow_{name}"
        await store.add_owner(owner, None)
    try:
        yield store, SubmissionStore(database)
    finally:
        await database.close()


def submission(name: str, owner: str = "ow_a", **more: Any) -> SubmissionRow:
    words = {"id": f"su_{name}", "owner_id": owner, "name": name, "name_key": name.lower(), "agent_made": True}
    row = {"suite": "smoke@3", "sha256": "0" * 64, "size": 1, "state": "queued", "created": 1.0}
    return SubmissionRow(**{**words, **row, **more})


def agent(name: str, owner: str = "ow_a") -> AgentRow:
    words = {"id": f"ag_{name}", "name": name, "name_key": name.lower(), "owner_id": owner}
    return AgentRow(**words, track="camera", kind="submitted", created=1.0)


def evaluation(name: str, agent_id: str) -> EvaluationRow:
    row = EvaluationRow(id=name, agent_id=agent_id, suite="smoke@3", suite_sha256="0", entry="uploaded")
    row.state, row.secret, row.trials, row.created = "running", "0", 2, 1.0
    return row


async def test_what_is_over_stays_as_it_is(database_url: str) -> None:
    told: list[str] = []

    async def tell(submission_id: str) -> None:
        told.append(submission_id)

    async with opened(database_url) as (_, submissions):
        submissions.token_ended = tell
        await submissions.add(submission("x"), None, most=1)
        assert await submissions.set_columns("su_x", token_sha256="t" * 64)
        assert (await submissions.by_token("t" * 64)) is not None
        assert await submissions.set_state("su_x", SubmissionState.RUNNING, token_sha256="u" * 64)
        assert await submissions.by_token("t" * 64) is None
        row = await submissions.by_token("u" * 64)
        assert row is not None
        first = row.started
        assert first is not None
        assert await submissions.set_state("su_x", SubmissionState.RUNNING, attempts=1)
        row = await submissions.get("su_x")
        assert row is not None
        assert (row.started, row.attempts, row.ended, row.token_sha256) == (first, 1, None, None)
        assert await submissions.set_state("su_x", SubmissionState.FAILED, reason="bad\0 \ud800" + 9000 * "x")
        for change in (SubmissionState.CANCELLED, SubmissionState.RUNNING):
            assert not await submissions.set_state("su_x", change, reason="too late")
        assert not await submissions.set_columns("su_x", attempts=7)
        assert not await submissions.set_state("su_unknown", SubmissionState.FAILED)
        row = await submissions.get("su_x")
        assert row is not None
        assert (row.state, row.attempts, row.token_sha256) == ("failed", 1, None)
        assert (row.reason or "").startswith("bad\ufffd ?xxx")
        assert len(row.reason or "") == 4000
        assert row.ended is not None
        assert told == ["su_x"] * 4


async def test_somebody_else_took_the_name(sqlite_url: str) -> None:
    async with opened(sqlite_url) as (store, submissions):
        await submissions.add(submission("swift"), None, most=9)
        taken = agent("Swift", "ow_b")
        taken.owner = new_owner("c")
        await store.add_agent(taken, None)
        with pytest.raises(AgentNameTakenError):
            await submissions.make_agent("su_swift", agent("swift"))
        row = await submissions.get("su_swift")
        assert row is not None
        assert row.agent_id is None
        assert await submissions.remove_agent("su_swift") is None
        assert await store.agent("ag_Swift") is not None
