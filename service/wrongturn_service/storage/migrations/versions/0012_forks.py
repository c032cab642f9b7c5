"""Practice episodes that are forks name their origin."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Add the column."""
    with op.batch_alter_table("episodes") as table:
        table.add_column(sa.Column("origin_id", sa.String(40), nullable=True))
        table.create_foreign_key("fk_episodes_origin_id", "episodes", ["origin_id"], ["id"], ondelete="SET NULL")
        table.create_index("ix_episodes_origin_id", ["origin_id"])
