"""Agents have owners; an evaluation counts from its first step."""

import secrets
import time

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
    # As text, because Alembic would copy SQLite's table, which other tables refer to.
    op.execute(
        "ALTER TABLE agents ADD COLUMN owner_id VARCHAR(40) CONSTRAINT fk_agents_owner_id REFERENCES owners (id)"
    )
    _give_owners()
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


def _give_owners() -> None:
    """Give each submitted agent an owner of its name, and the shipped ones the owner Wrongturn, a reserved name."""
    connection = op.get_bind()
    insert = sa.text("INSERT INTO owners (id, name, name_key, created) VALUES (:id, :name, :name_key, :created)")
    shipped = {"id": f"ow_{secrets.token_hex(12)}", "name": "Wrongturn", "name_key": "wrongturn"}
    connection.execute(insert, {**shipped, "created": time.time()})
    connection.execute(
        sa.text("UPDATE agents SET owner_id = :owner WHERE kind <> 'submitted'"), {"owner": shipped["id"]}
    )
    # Ids of agents begin with "ag".
    op.execute(
        "INSERT INTO owners (id, name, name_key, created) "
        "SELECT 'ow' || substr(id, 3), name, name_key, created FROM agents "
        "WHERE kind = 'submitted' AND name_key <> 'wrongturn'"
    )
    op.execute(
        "UPDATE agents SET owner_id = 'ow' || substr(id, 3) WHERE kind = 'submitted' AND name_key <> 'wrongturn'"
    )
    like_shipped = "SELECT id, name, created FROM agents WHERE kind = 'submitted' AND name_key = 'wrongturn'"
    for agent, name, created in connection.execute(sa.text(like_shipped)).all():
        taken = set(connection.scalars(sa.text("SELECT name_key FROM owners")))
        free = next(wanted for n in range(2, len(taken) + 3) if (wanted := f"{name}-{n}").lower() not in taken)
        owner = f"ow{agent[2:]}"
        connection.execute(insert, {"id": owner, "name": free, "name_key": free.lower(), "created": created})
        connection.execute(
            sa.text("UPDATE agents SET owner_id = :owner WHERE id = :agent"), {"owner": owner, "agent": agent}
        )


def downgrade() -> None:
    op.drop_table("unused_secrets")
    op.drop_column("evaluations", "driven")
    op.drop_index(op.f("ix_agents_owner_id"), table_name="agents")
    with op.batch_alter_table("agents") as batch_op:
        batch_op.drop_constraint("fk_agents_owner_id", type_="foreignkey")
        batch_op.drop_column("owner_id")
    op.drop_table("owners")
