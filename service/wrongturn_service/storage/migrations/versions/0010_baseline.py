"""All tables. Databases of earlier versions are refused: nobody outside had one."""

from functools import partial

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = None
branch_labels = None
depends_on = None

S40 = sa.String(40)
S32 = sa.String(32)
S64 = sa.String(64)
ZERO = sa.text("0")
KEPT = sa.text("state <> 'lost'")
CASCADE = partial(sa.ForeignKey, ondelete="CASCADE")
SET_NULL = partial(sa.ForeignKey, ondelete="SET NULL")
# A copy of the models as they were: the next migration starts from it.
tables = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_name)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)
sa.Table(
    "audit",
    tables,
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("time", sa.Double, nullable=False),
    sa.Column("actor", S32, nullable=False),
    sa.Column("address", S64, nullable=False),
    sa.Column("action", S32, nullable=False),
    sa.Column("kind", S32, nullable=False),
    sa.Column("target", S40, nullable=False, index=True),
    sa.Column("name", sa.String(160), nullable=False),
    sa.Column("reason", sa.Text),
    sa.Column("counts", sa.Text, nullable=False),
    sa.Column("done", sa.Boolean, nullable=False),
)
sa.Table(
    "owners",
    tables,
    sa.Column("id", S40, primary_key=True),
    sa.Column("name", S64, nullable=False),
    sa.Column("name_key", S64, nullable=False, unique=True),
    sa.Column("contact", sa.Text),
    sa.Column("token_sha256", S64, unique=True),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("hidden", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Column("origin", S64, index=True),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
    sa.Column("active", sa.Double),
)
sa.Table(
    "ownership",
    tables,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("holder", S40, nullable=False),
    sa.Column("since", sa.Double, nullable=False),
)
sa.Table(
    "probe",
    tables,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("data", sa.LargeBinary, nullable=False),
)
sa.Table(
    "agents",
    tables,
    sa.Column("id", S40, primary_key=True),
    sa.Column("name", S64, nullable=False),
    sa.Column("name_key", S64, nullable=False, unique=True),
    sa.Column("track", S32, nullable=False),
    sa.Column("kind", S32, nullable=False),
    sa.Column("description", sa.Text),
    sa.Column("homepage", sa.Text),
    sa.Column("trained_on_faults", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
    sa.Column("token_sha256", S64, unique=True),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("owner_id", S40, CASCADE("owners.id"), nullable=False, index=True),
    sa.Column("hidden", sa.Boolean, nullable=False, server_default=sa.false()),
)
sa.Table(
    "evaluations",
    tables,
    sa.Column("id", S40, primary_key=True),
    sa.Column("agent_id", S40, CASCADE("agents.id"), nullable=False, index=True),
    sa.Column("suite", sa.String(80), nullable=False, index=True),
    sa.Column("suite_sha256", S64, nullable=False),
    sa.Column("entry", S32, nullable=False),
    sa.Column("state", S32, nullable=False),
    sa.Column("secret", S64, nullable=False),
    sa.Column("trials", sa.Integer, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("finished", sa.Double),
    sa.Column("metrics", sa.Text),
    sa.Column("driven", sa.Double),
    sa.Column("hidden", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Column("seq", sa.BigInteger, nullable=False, unique=True),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
)
sa.Table(
    "held",
    tables,
    sa.Column("kind", S32, primary_key=True),
    sa.Column("key", sa.String(128), primary_key=True),
    sa.Column("agent_id", S40, CASCADE("agents.id"), index=True),
    sa.Column("deleted", S40, nullable=False, index=True),
)
sa.Table(
    "unused_secrets",
    tables,
    sa.Column("agent_id", S40, CASCADE("agents.id"), primary_key=True),
    sa.Column("suite", sa.String(80), primary_key=True),
    sa.Column("secret", S64, nullable=False),
)
sa.Table(
    "episodes",
    tables,
    sa.Column("id", S40, primary_key=True),
    sa.Column("evaluation_id", S40, CASCADE("evaluations.id")),
    sa.Column("agent_id", S40, CASCADE("agents.id"), nullable=False),
    sa.Column("trial_id", sa.String(160), nullable=False),
    sa.Column("trial", sa.Text, nullable=False),
    sa.Column("track", S32, nullable=False),
    sa.Column("state", S32, nullable=False, index=True),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("finished", sa.Double),
    sa.Column("verdict", S32),
    sa.Column("outcome", sa.Text),
    sa.Column("steps", sa.Integer, nullable=False),
    sa.Column("last_action", sa.LargeBinary),
    sa.Column("last_reply", sa.LargeBinary),
    sa.Column("actions_sha256", S64),
    sa.Column("trajectory_sha256", S64),
    sa.Column("seq", sa.Integer),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
    sa.Index("ix_episodes_agent_id_finished", "agent_id", "finished"),
    sa.Index("ix_episodes_evaluation_id_seq", "evaluation_id", "seq"),
    sa.Index("ix_episodes_evaluation_id_state", "evaluation_id", "state"),
    sa.Index(
        "uq_episodes_evaluation_id_trial_id",
        "evaluation_id",
        "trial_id",
        unique=True,
        sqlite_where=KEPT,
        postgresql_where=KEPT,
    ),
)
sa.Table(
    "results",
    tables,
    sa.Column("evaluation_id", S40, CASCADE("evaluations.id"), primary_key=True),
    sa.Column("body", sa.Text, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
)
sa.Table(
    "submissions",
    tables,
    sa.Column("id", S40, primary_key=True),
    sa.Column("seq", sa.BigInteger, nullable=False, unique=True),
    sa.Column("owner_id", S40, CASCADE("owners.id"), nullable=False, index=True),
    sa.Column("agent_id", S40, SET_NULL("agents.id"), index=True),
    sa.Column("agent_made", sa.Boolean, nullable=False),
    sa.Column("evaluation_id", S40, SET_NULL("evaluations.id"), index=True),
    sa.Column("suite", sa.String(80), nullable=False),
    sa.Column("name", S64, nullable=False),
    sa.Column("name_key", S64, nullable=False, index=True),
    sa.Column("track", S32),
    sa.Column("sha256", S64, nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
    sa.Column("state", S32, nullable=False, index=True),
    sa.Column("reason", sa.Text),
    sa.Column("token_sha256", S64, unique=True),
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("started", sa.Double),
    sa.Column("ended", sa.Double),
)
sa.Table(
    "idempotency",
    tables,
    sa.Column("scope", sa.String(80), primary_key=True),
    sa.Column("key_sha256", S64, primary_key=True),
    sa.Column("request_sha256", S64, nullable=False),
    sa.Column("status", sa.Integer, nullable=False),
    sa.Column("content_type", sa.String(80), nullable=False),
    sa.Column("body", sa.LargeBinary, nullable=False),
    sa.Column("with_token", sa.Boolean, nullable=False),
    sa.Column("created", sa.Double, nullable=False, index=True),
    sa.Column("owner_id", S40, CASCADE("owners.id"), nullable=False, index=True),
    sa.Column("agent_id", S40, CASCADE("agents.id"), index=True),
    sa.Column("evaluation_id", S40, index=True),
    sa.Column("episode_id", S40, CASCADE("episodes.id"), index=True),
    sa.Column("submission_id", S40, CASCADE("submissions.id"), index=True),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False, server_default=ZERO),
)
sa.Table(
    "submission_log",
    tables,
    sa.Column("submission_id", S40, CASCADE("submissions.id"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("time", sa.Double, nullable=False),
    sa.Column("message", sa.Text, nullable=False),
)
sa.Table(
    "trajectories",
    tables,
    sa.Column("episode_id", S40, CASCADE("episodes.id"), primary_key=True),
    sa.Column("sha256", S64, nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    sa.Column("data", sa.LargeBinary, nullable=False),
)


def upgrade() -> None:
    tables.create_all(op.get_bind())


def downgrade() -> None:
    tables.drop_all(op.get_bind())
