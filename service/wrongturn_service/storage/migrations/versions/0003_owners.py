"""Agents have owners; an evaluation counts from its first step."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "owners",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False),
        sa.Column("contact", sa.Text(), nullable=True),
        sa.Column("token_sha256", sa.String(length=64), nullable=True),
        sa.Column("created", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_owners")),
        sa.UniqueConstraint("name_key", name=op.f("uq_owners_name_key")),
        sa.UniqueConstraint("token_sha256", name=op.f("uq_owners_token_sha256")),
    )
    # Each agent gets an owner of its name. Ids of agents begin with "ag".
    op.execute(
        "INSERT INTO owners (id, name, name_key, created) "
        "SELECT 'ow' || substr(id, 3), name, name_key, created FROM agents"
    )
    # As text, because Alembic would copy SQLite's table, which other tables refer to.
    op.execute(
        "ALTER TABLE agents ADD COLUMN owner_id VARCHAR(40) CONSTRAINT fk_agents_owner_id REFERENCES owners (id)"
    )
    op.execute("UPDATE agents SET owner_id = 'ow' || substr(id, 3)")
    op.create_index(op.f("ix_agents_owner_id"), "agents", ["owner_id"])
    op.add_column("evaluations", sa.Column("driven", sa.Double(), nullable=True))
    # Steps were not stored before an episode's end, so an evaluation with any episode counts as driven.
    op.execute(
        "UPDATE evaluations SET driven = "
        "(SELECT min(episodes.created) FROM episodes WHERE episodes.evaluation_id = evaluations.id)"
    )
    op.create_table(
        "unused_secrets",
        sa.Column("agent_id", sa.String(length=40), nullable=False),
        sa.Column("suite", sa.String(length=80), nullable=False),
        sa.Column("secret", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["agent_id"], ["agents.id"], name=op.f("fk_unused_secrets_agent_id")),
        sa.PrimaryKeyConstraint("agent_id", "suite", name=op.f("pk_unused_secrets")),
    )


def downgrade() -> None:
    op.drop_table("unused_secrets")
    op.drop_column("evaluations", "driven")
    op.drop_index(op.f("ix_agents_owner_id"), table_name="agents")
    with op.batch_alter_table("agents") as batch_op:
        batch_op.drop_constraint("fk_agents_owner_id", type_="foreignkey")
        batch_op.drop_column("owner_id")
    op.drop_table("owners")
