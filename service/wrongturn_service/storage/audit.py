"""The audit log: what the operator did, written in the transaction that does it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol.administration import Contents
from wrongturn_protocol.vocabulary import AuditAction, Collection
from wrongturn_service.storage.models import AuditRow
from wrongturn_service.storage.queries import next_number

_LONGEST_NAME = 160


@dataclass(frozen=True)
class Act:
    """Who does something, from where, and why."""

    actor: str
    """``operator``, and the first digits of the SHA-256 of the token that was sent."""
    address: str
    reason: str | None = None

    async def note(
        self, session: AsyncSession, action: AuditAction, target: tuple[Collection, str, str], contents: Contents
    ) -> None:
        """Add an entry about a target, by its kind, its id and its name, as the last one."""
        collection, item_id, name = target
        entry = AuditRow(
            seq=await next_number(session, AuditRow.seq),
            time=time.time(),
            actor=self.actor,
            address=self.address[:64],
            action=action.value,
            kind=collection.value,
            target=item_id,
            name=name[:_LONGEST_NAME],
            reason=self.reason,
            counts=contents.model_dump_json(exclude_defaults=True),
        )
        session.add(entry)


async def entries(
    session: AsyncSession,
    *,
    before: int | None,
    limit: int,
    target: str | None = None,
    named: tuple[Collection, str] | None = None,
    action: AuditAction | None = None,
) -> Sequence[AuditRow]:
    """Return entries, newest first.

    ``before`` is a number, ``target`` an id, and ``named`` the kind of a target and a name that it has, or had, in
    upper or lower case.
    """
    query = select(AuditRow).order_by(AuditRow.seq.desc()).limit(limit)
    if before is not None:
        query = query.where(AuditRow.seq < before)
    if target is not None:
        query = query.where(AuditRow.target == target)
    if named is not None:
        collection, name = named
        query = query.where(AuditRow.kind == collection, func.lower(AuditRow.name) == name.lower())
    if action is not None:
        query = query.where(AuditRow.action == action)
    return (await session.scalars(query)).all()
