"""How Alembic reaches the database: by the connection that the service hands it."""

from alembic import context

from wrongturn_service.storage.models import Base

# SQLite alters tables by copying them, which Alembic calls batch mode.
context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, render_as_batch=True
)
with context.begin_transaction():
    context.run_migrations()
