"""What all groups of queries share."""

from collections.abc import Sequence
from typing import Any, TypeVar

from sqlalchemy import Executable, Select, func, select
from sqlalchemy.ext.asyncio import AsyncSession

from wrongturn_service.storage.database import Database
from wrongturn_service.storage.usage import Quota, Usage

_T = TypeVar("_T")


async def next_number(session: AsyncSession, column: Any, *where: Any) -> int:
    """Return the number that follows the largest one of a column, from 1."""
    return (await session.scalar(select(func.max(column)).where(*where)) or 0) + 1


class Queries:
    """Queries on a database. Each method is one transaction."""

    def __init__(self, database: Database, quota: Quota | None = None) -> None:
        """Use a database. Without a quota, owners and addresses have no limits."""
        self._database = database
        self._usage = Usage(quota)

    async def _get(self, row: type[_T], key: Any) -> _T | None:
        """Return the row with this key, or None."""
        async with self._database.read() as session:
            return await session.get(row, key)

    async def _one(self, query: "Select[_T]") -> _T | None:
        """Return the first value of a query, or None."""
        async with self._database.read() as session:
            return await session.scalar(query)

    async def _all(self, query: "Select[_T]") -> Sequence[_T]:
        """Return the first value of each row of a query."""
        async with self._database.read() as session:
            return (await session.scalars(query)).all()

    async def _rows(self, query: Any) -> Sequence[Any]:
        """Return the rows of a query."""
        async with self._database.read() as session:
            return (await session.execute(query)).tuples().all()

    async def _write(self, *statements: Executable) -> int:
        """Execute statements in one transaction, and return how many rows the last one has changed."""
        async with self._database.write() as session:
            changed = 0
            for statement in statements:
                changed = int(getattr(await session.execute(statement), "rowcount", 0))
            return changed
