"""The queries of pages, and how PostgreSQL answers them."""

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from sqlalchemy import event
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

LARGE: Final = {"episodes", "trajectories"}
"""Tables that no page may read from end to end."""


@dataclass(frozen=True)
class Query:
    """One statement that was sent, with its parameters."""

    statement: str
    parameters: tuple[Any, ...] = field(hash=False)

    @property
    def about(self) -> str:
        """What it reads, in a line."""
        line = " ".join(self.statement.split())
        return "SELECT … " + line[line.find(" FROM ") + 1 :] if " FROM " in line else line


@contextlib.contextmanager
def recorded(engine: AsyncEngine) -> Iterator[list[Query]]:
    """Collect the reading statements of an engine while the block runs."""
    found: list[Query] = []

    def note(_connection: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if statement.lstrip().startswith("SELECT") and " FROM " in " ".join(statement.split()):
            found.append(Query(statement, tuple(parameters)))

    event.listen(engine.sync_engine, "before_cursor_execute", note)
    try:
        yield found
    finally:
        event.remove(engine.sync_engine, "before_cursor_execute", note)


async def plan(connection: AsyncConnection, query: Query) -> dict[str, Any]:
    """Return PostgreSQL's plan of a query, with the times of running it."""
    reply = await connection.exec_driver_sql(
        f"EXPLAIN (ANALYZE, BUFFERS, FORMAT JSON) {query.statement}", query.parameters
    )
    found = reply.scalar_one()
    made: dict[str, Any] = (json.loads(found) if isinstance(found, str) else found)[0]
    return made


def nodes(made: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield all nodes of a plan, from the top down."""
    waiting = [made["Plan"]]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += node.get("Plans", [])


def scanned(made: dict[str, Any]) -> set[str]:
    """Return the large tables that a plan reads from end to end."""
    return {node["Relation Name"] for node in nodes(made) if node["Node Type"].endswith("Seq Scan")} & LARGE


def outline(made: dict[str, Any]) -> list[str]:
    """Return a plan in a few words a node."""
    lines = []
    for node in nodes(made):
        words = [node["Node Type"], node.get("Index Name") or node.get("Relation Name") or ""]
        lines.append(f"{' '.join(filter(None, words))}: {node['Actual Rows']:.0f} rows x {node['Actual Loops']}")
    return lines
