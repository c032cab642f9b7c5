"""Agents may have a rig."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the column."""
    with op.batch_alter_table("agents") as table:
        table.add_column(sa.Column("rig", sa.Text, nullable=True))
