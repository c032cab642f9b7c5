"""Names and places on suites that stay taken after their holder was deleted."""

from sqlalchemy import delete, select
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.storage.models import HeldRow


def place(agent_id: str, suite: str) -> str:
    """Return the key of an agent's place on a suite."""
    return f"{agent_id} {suite}"


async def is_held(session: AsyncSession, kind: Collection, key: str) -> bool:
    """Return whether the name of an owner or an agent, in lower case, or an evaluation's place on a suite is taken."""
    return await session.get(HeldRow, (kind.one, key)) is not None


async def free(session: AsyncSession, deleted: str) -> int:
    """Give back what a deletion kept taken, and return how much that was."""
    result = await session.execute(delete(HeldRow).where(HeldRow.deleted == deleted))
    return int(getattr(result, "rowcount", 0))


async def held_by(session: AsyncSession, deleted: str) -> tuple[str, ...]:
    """Return what a deletion keeps taken, in words."""
    rows = (await session.scalars(select(HeldRow).where(HeldRow.deleted == deleted))).all()
    return tuple(sorted(_words(row) for row in rows))


def _words(row: HeldRow) -> str:
    if row.kind == Collection.EVALUATIONS.one:
        agent, _, suite = row.key.partition(" ")
        return f"the place of agent {agent} on {suite}"
    return f"the name {row.key!r} of an {row.kind}"
