"""How Alembic reaches the database: by the connection that the service hands it, or by ``sqlalchemy.url``."""

import asyncio

from alembic import context
from sqlalchemy import Connection
from sqlalchemy.ext.asyncio import create_async_engine

from wrongturn_service.storage.models import Base


def _migrate(connection: Connection) -> None:
    # SQLite alters tables by copying them, which Alembic calls batch mode.
    context.configure(connection=connection, target_metadata=Base.metadata, render_as_batch=True)
    with context.begin_transaction():
        context.run_migrations()


async def _connect(url: str) -> None:
    engine = create_async_engine(url)
    try:
        async with engine.begin() as connection:
            await connection.run_sync(_migrate)
    finally:
        await engine.dispose()


given = context.config.attributes.get("connection")
if given is not None:
    _migrate(given)
else:
    asyncio.run(_connect(context.config.get_main_option("sqlalchemy.url") or ""))
