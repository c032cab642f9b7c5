"""Stored bytes are counted for each owner and the address that registered it."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

TABLES = ("owners", "agents", "evaluations", "episodes", "results", "idempotency", "submissions")


def upgrade() -> None:
    for table in TABLES:
        op.add_column(table, sa.Column("stored_bytes", sa.BigInteger(), nullable=False, server_default=sa.text("0")))
    op.add_column("owners", sa.Column("origin", sa.String(length=64), nullable=True))
    op.add_column("owners", sa.Column("active", sa.Double(), nullable=True))
    op.add_column("idempotency", sa.Column("owner_id", sa.String(length=40), nullable=True))
    op.add_column("idempotency", sa.Column("episode_id", sa.String(length=40), nullable=True))
    op.create_index(op.f("ix_owners_origin"), "owners", ["origin"])
    op.create_index(op.f("ix_idempotency_owner_id"), "idempotency", ["owner_id"])
    op.create_index(op.f("ix_idempotency_episode_id"), "idempotency", ["episode_id"])
    op.create_index(op.f("ix_episodes_agent_id_finished"), "episodes", ["agent_id", "finished"])
    _count()


def _count() -> None:
    """Count what is there. Replies to keys are left out, because they are deleted within days."""
    op.execute(f"UPDATE agents SET stored_bytes = 1024 + {_size('description')} + {_size('homepage')}")
    op.execute(
        f"UPDATE episodes SET stored_bytes = 1024 + {_size('trial')} + {_size('outcome')} + {_size('last_reply')} + "
        "coalesce((SELECT 4096 + length(data) FROM trajectories WHERE episode_id = episodes.id), 0)"
    )
    op.execute(
        f"UPDATE evaluations SET stored_bytes = 1024 + {_size('metrics')} + "
        "coalesce((SELECT sum(stored_bytes) FROM episodes WHERE evaluation_id = evaluations.id), 0)"
    )
    op.execute(f"UPDATE results SET stored_bytes = 1024 + {_size('body')}")
    op.execute("UPDATE submissions SET stored_bytes = 8192 + size")
    op.execute(
        f"UPDATE owners SET active = created, stored_bytes = 1024 + {_size('contact')} + "
        "coalesce((SELECT sum(stored_bytes) FROM agents WHERE owner_id = owners.id), 0) + "
        "coalesce((SELECT sum(stored_bytes) FROM submissions WHERE owner_id = owners.id), 0) + "
        "coalesce((SELECT sum(evaluations.stored_bytes) FROM evaluations "
        "JOIN agents ON agents.id = agent_id WHERE owner_id = owners.id), 0) + "
        "coalesce((SELECT sum(episodes.stored_bytes) FROM episodes JOIN agents ON agents.id = agent_id "
        "WHERE owner_id = owners.id AND evaluation_id IS NULL), 0) + "
        "coalesce((SELECT sum(results.stored_bytes) FROM results JOIN evaluations ON evaluations.id = evaluation_id "
        "JOIN agents ON agents.id = agent_id WHERE owner_id = owners.id), 0)"
    )


def _size(column: str) -> str:
    if op.get_bind().dialect.name == "postgresql":
        return f"coalesce(octet_length({column}), 0)"
    return f"coalesce(length(CAST({column} AS BLOB)), 0)"


def downgrade() -> None:
    op.drop_index(op.f("ix_episodes_agent_id_finished"), table_name="episodes")
    op.drop_index(op.f("ix_idempotency_episode_id"), table_name="idempotency")
    op.drop_index(op.f("ix_idempotency_owner_id"), table_name="idempotency")
    op.drop_index(op.f("ix_owners_origin"), table_name="owners")
    for column in ("episode_id", "owner_id"):
        op.drop_column("idempotency", column)
    for column in ("active", "origin"):
        op.drop_column("owners", column)
    for table in TABLES:
        op.drop_column(table, "stored_bytes")
