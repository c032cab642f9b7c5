"""A trial counts once in an evaluation; who has a server's database."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "ownership",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("holder", sa.String(length=40), nullable=False),
        sa.Column("since", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_ownership")),
    )
    # No service runs while tables change, so what is open now is lost; and of a trial's verdicts the first counts.
    op.execute("UPDATE episodes SET state = 'lost' WHERE state = 'open'")
    op.execute(
        "UPDATE episodes SET state = 'lost' WHERE state = 'finished' AND EXISTS ("
        "SELECT 1 FROM episodes AS first WHERE first.evaluation_id = episodes.evaluation_id "
        "AND first.trial_id = episodes.trial_id AND first.state = 'finished' AND (first.finished < episodes.finished "
        "OR (first.finished = episodes.finished AND first.id < episodes.id)))"
    )
    op.create_index(
        "uq_episodes_evaluation_id_trial_id",
        "episodes",
        ["evaluation_id", "trial_id"],
        unique=True,
        sqlite_where=sa.text("state <> 'lost'"),
        postgresql_where=sa.text("state <> 'lost'"),
    )


def downgrade() -> None:
    op.drop_index("uq_episodes_evaluation_id_trial_id", table_name="episodes")
    op.drop_table("ownership")
