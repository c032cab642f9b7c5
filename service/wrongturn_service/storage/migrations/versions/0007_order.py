"""Evaluations and their episodes are numbered in their order."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("evaluations", sa.Column("seq", sa.BigInteger(), nullable=True))
    op.add_column("episodes", sa.Column("seq", sa.Integer(), nullable=True))
    # The times decided before, so they decide about what is there.
    op.execute(
        "UPDATE evaluations SET seq = numbered.seq FROM "
        "(SELECT id, row_number() OVER (ORDER BY created, id) AS seq FROM evaluations) AS numbered "
        "WHERE numbered.id = evaluations.id"
    )
    op.execute(
        "UPDATE episodes SET seq = numbered.seq FROM "
        "(SELECT id, row_number() OVER (PARTITION BY evaluation_id ORDER BY created, id) AS seq FROM episodes "
        "WHERE evaluation_id IS NOT NULL) AS numbered WHERE numbered.id = episodes.id"
    )
    op.create_index(op.f("ix_evaluations_seq"), "evaluations", ["seq"], unique=True)
    op.create_index("ix_episodes_evaluation_id_seq", "episodes", ["evaluation_id", "seq"])


def downgrade() -> None:
    op.drop_index("ix_episodes_evaluation_id_seq", table_name="episodes")
    op.drop_index(op.f("ix_evaluations_seq"), table_name="evaluations")
    op.drop_column("episodes", "seq")
    op.drop_column("evaluations", "seq")
