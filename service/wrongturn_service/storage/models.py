"""The tables, with types that SQLite and PostgreSQL share. Times are seconds since 1970, UTC."""

from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
    false,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

_ID = String(40)
_WORD = String(32)
_SHA = String(64)


class Base(DeclarativeBase):
    """Base of the tables. It fixes the names of constraints for the migrations."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_name)s",
            "uq": "uq_%(table_name)s_%(column_0_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s",
            "pk": "pk_%(table_name)s",
        }
    )


def _of(table: str, *, ondelete: str = "CASCADE", **options: Any) -> Any:
    """Return a column with the id of the row to which a row belongs, and with which it is deleted."""
    return mapped_column(_ID, ForeignKey(f"{table}.id", ondelete=ondelete), **options)


def _bytes() -> Any:
    """Return a column that counts bytes."""
    return mapped_column(BigInteger, insert_default=0, server_default=text("0"))


class OwnerRow(Base):
    """Who answers for agents. One that was made with its agent has no token."""

    __tablename__ = "owners"

    id: Mapped[str] = mapped_column(_ID, primary_key=True)
    name: Mapped[str] = mapped_column(String(64))
    name_key: Mapped[str] = mapped_column(String(64), unique=True)
    """The name in lower case: names may not differ in case alone."""
    contact: Mapped[str | None] = mapped_column(Text)
    """For the operator's eyes."""
    token_sha256: Mapped[str | None] = mapped_column(_SHA, unique=True)
    created: Mapped[float] = mapped_column(Double)
    hidden: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())
    """Whether the operator hides it, its agents and their evaluations from everybody else."""
    origin: Mapped[str | None] = mapped_column(String(64), index=True)
    """The address that registered it, as limits count addresses. None if the operator did."""
    stored_bytes: Mapped[int] = _bytes()
    """Bytes of all that is stored for it, or more, see :mod:`wrongturn_service.storage.usage`."""
    active: Mapped[float | None] = mapped_column(Double)
    """When something was last stored for it."""


class AgentRow(Base):
    """An agent. A revoked one has no token."""

    __tablename__ = "agents"

    id: Mapped[str] = mapped_column(_ID, primary_key=True)
    name: Mapped[str] = mapped_column(String(64))
    name_key: Mapped[str] = mapped_column(String(64), unique=True)
    """The name in lower case: names may not differ in case alone."""
    track: Mapped[str] = mapped_column(_WORD)
    rig: Mapped[str | None] = mapped_column(Text)
    """JSON of Rig; None: what the track shows."""
    kind: Mapped[str] = mapped_column(_WORD)
    description: Mapped[str | None] = mapped_column(Text)
    homepage: Mapped[str | None] = mapped_column(Text)
    trained_on_faults: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())
    """Whether it met wrong commands in its training, as its owner says."""
    stored_bytes: Mapped[int] = _bytes()
    token_sha256: Mapped[str | None] = mapped_column(_SHA, unique=True)
    created: Mapped[float] = mapped_column(Double)
    owner_id: Mapped[str] = _of("owners", index=True)
    owner: Mapped[OwnerRow] = relationship(lazy="joined")
    hidden: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())
    """Whether the operator hides it and its evaluations."""

    @property
    def unseen(self) -> bool:
        """Whether it is hidden, alone or with its owner."""
        return self.hidden or self.owner.hidden


class EvaluationRow(Base):
    """One agent on one suite."""

    __tablename__ = "evaluations"

    id: Mapped[str] = mapped_column(_ID, primary_key=True)
    agent_id: Mapped[str] = _of("agents", index=True)
    suite: Mapped[str] = mapped_column(String(80), index=True)
    suite_sha256: Mapped[str] = mapped_column(_SHA)
    entry: Mapped[str] = mapped_column(_WORD)
    state: Mapped[str] = mapped_column(_WORD)
    secret: Mapped[str] = mapped_column(_SHA)
    """Decides the trials, if the suite has cells, and their order."""
    trials: Mapped[int] = mapped_column(Integer)
    created: Mapped[float] = mapped_column(Double)
    finished: Mapped[float | None] = mapped_column(Double)
    metrics: Mapped[str | None] = mapped_column(Text)
    """JSON of Metrics, once finished."""
    versions: Mapped[str | None] = mapped_column(Text)
    """JSON of the versions of the service's packages when it finished, by name."""
    driven: Mapped[float | None] = mapped_column(Double)
    """When its first step arrived. From then on it counts."""
    hidden: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())
    """Whether the operator hides it. It still counts as the agent's first one."""
    seq: Mapped[int] = mapped_column(BigInteger, unique=True)
    """Order in which evaluations were begun, from 1. It decides what counts first, because clocks can be set back."""
    stored_bytes: Mapped[int] = _bytes()
    """Bytes of the row; while it runs, what it and its episodes can come to."""


class UnusedSecretRow(Base):
    """The secret of an evaluation that was deleted before its first step. The agent's next one on the suite takes it.

    Without this an agent could look at first observations, delete, and begin again until a draw looks easy.
    """

    __tablename__ = "unused_secrets"

    agent_id: Mapped[str] = _of("agents", primary_key=True)
    suite: Mapped[str] = mapped_column(String(80), primary_key=True)
    secret: Mapped[str] = mapped_column(_SHA)


class EpisodeRow(Base):
    """One drive of one trial. Practice has no evaluation."""

    __tablename__ = "episodes"

    id: Mapped[str] = mapped_column(_ID, primary_key=True)
    evaluation_id: Mapped[str | None] = _of("evaluations")
    agent_id: Mapped[str] = _of("agents")
    trial_id: Mapped[str] = mapped_column(String(160))
    trial: Mapped[str] = mapped_column(Text)
    """JSON of Trial."""
    track: Mapped[str] = mapped_column(_WORD)
    state: Mapped[str] = mapped_column(_WORD, index=True)
    created: Mapped[float] = mapped_column(Double)
    finished: Mapped[float | None] = mapped_column(Double)
    verdict: Mapped[str | None] = mapped_column(_WORD)
    outcome: Mapped[str | None] = mapped_column(Text)
    """JSON of Outcome."""
    steps: Mapped[int] = mapped_column(Integer, default=0)
    last_action: Mapped[bytes | None] = mapped_column(LargeBinary)
    """The last step's action, 3 little-endian float32, to recognise its repeat after a restart."""
    last_reply: Mapped[bytes | None] = mapped_column(LargeBinary)
    """The last step's reply, compressed JSON."""
    actions_sha256: Mapped[str | None] = mapped_column(_SHA)
    trajectory_sha256: Mapped[str | None] = mapped_column(_SHA)
    seq: Mapped[int | None] = mapped_column(Integer)
    """Order of the resets of an evaluation, from 1. Practice has none."""
    origin_id: Mapped[str | None] = _of("episodes", ondelete="SET NULL", index=True)
    """The episode that this practice is a fork of."""
    stored_bytes: Mapped[int] = _bytes()
    """Bytes of the row and its trajectory. Practice has what they can come to until its end."""

    __table_args__ = (
        Index("ix_episodes_agent_id_finished", "agent_id", "finished"),
        Index("ix_episodes_evaluation_id_state", "evaluation_id", "state"),
        Index("ix_episodes_evaluation_id_seq", "evaluation_id", "seq"),
        # A trial counts once in an evaluation. Lost episodes run again.
        Index(
            "uq_episodes_evaluation_id_trial_id",
            "evaluation_id",
            "trial_id",
            unique=True,
            sqlite_where=text("state <> 'lost'"),
            postgresql_where=text("state <> 'lost'"),
        ),
    )


class TrajectoryRow(Base):
    """A finished episode's trajectory."""

    __tablename__ = "trajectories"

    episode_id: Mapped[str] = _of("episodes", primary_key=True)
    sha256: Mapped[str] = mapped_column(_SHA)
    """SHA-256 of the canonical JSON."""
    size: Mapped[int] = mapped_column(BigInteger)
    """Bytes of the canonical JSON."""
    data: Mapped[bytes] = mapped_column(LargeBinary)
    """The canonical JSON, compressed by zlib."""


class ResultsRow(Base):
    """A worker's own record of an evaluation."""

    __tablename__ = "results"

    evaluation_id: Mapped[str] = _of("evaluations", primary_key=True)
    body: Mapped[str] = mapped_column(Text)
    """JSON of ResultsRequest."""
    created: Mapped[float] = mapped_column(Double)
    stored_bytes: Mapped[int] = _bytes()


class IdempotencyRow(Base):
    """A stored reply for the repeat of a request."""

    __tablename__ = "idempotency"

    scope: Mapped[str] = mapped_column(String(80), primary_key=True)
    """Whose key it is, for example an agent's id."""
    key_sha256: Mapped[str] = mapped_column(_SHA, primary_key=True)
    request_sha256: Mapped[str] = mapped_column(_SHA)
    status: Mapped[int] = mapped_column(Integer)
    content_type: Mapped[str] = mapped_column(String(80))
    body: Mapped[bytes] = mapped_column(LargeBinary)
    with_token: Mapped[bool] = mapped_column(Boolean)
    """Whether the reply had a token. It is stored nowhere: a repeat makes a new one, which ends the old one."""
    created: Mapped[float] = mapped_column(Double, index=True)
    owner_id: Mapped[str] = _of("owners", index=True)
    """The owner whose bytes it counts to."""
    agent_id: Mapped[str | None] = _of("agents", index=True)
    """The agent that sent the request, or that it registered."""
    evaluation_id: Mapped[str | None] = mapped_column(_ID, index=True)
    """The evaluation that the request began or drove. An evaluation that its agent deletes leaves the reply."""
    episode_id: Mapped[str | None] = _of("episodes", index=True)
    """The episode that the request began."""
    submission_id: Mapped[str | None] = _of("submissions", index=True)
    """The submission that the request handed in."""
    stored_bytes: Mapped[int] = _bytes()


def names_of(owner: str, origin: str | None) -> tuple[str, str]:
    """Return an owner's address and the owner, who take turns. An owner without an address has one of its own."""
    return f"at {origin or owner}", owner


class SubmissionRow(Base):
    """A model that was handed in. The row stays when the model and the log are deleted."""

    __tablename__ = "submissions"

    id: Mapped[str] = mapped_column(_ID, primary_key=True)
    seq: Mapped[int] = mapped_column(BigInteger, unique=True)
    """Order of arrival, from 1."""
    owner_id: Mapped[str] = _of("owners", index=True)
    agent_id: Mapped[str | None] = _of("agents", ondelete="SET NULL", index=True)
    """The agent that handed it in, or the one that was made after the check."""
    agent_made: Mapped[bool] = mapped_column(Boolean)
    """Whether the service makes the agent, for this submission or an earlier one of the same model. Otherwise the agent
    was there before, and handed it in."""
    evaluation_id: Mapped[str | None] = _of("evaluations", ondelete="SET NULL", index=True)
    suite: Mapped[str] = mapped_column(String(80))
    name: Mapped[str] = mapped_column(String(64))
    name_key: Mapped[str] = mapped_column(String(64), index=True)
    """The agent's name in lower case."""
    track: Mapped[str | None] = mapped_column(_WORD)
    """Track of the agent, once the model is checked."""
    sha256: Mapped[str] = mapped_column(_SHA)
    size: Mapped[int] = mapped_column(BigInteger)
    stored_bytes: Mapped[int] = _bytes()
    """Bytes of the row, its log and, while it is there, the model."""
    state: Mapped[str] = mapped_column(_WORD, index=True)
    reason: Mapped[str | None] = mapped_column(Text)
    """Why it failed or was cancelled, and what to do."""
    token_sha256: Mapped[str | None] = mapped_column(_SHA, unique=True)
    """Of the runner's token, which is good for this submission alone and ends with its state."""
    attempts: Mapped[int] = mapped_column(Integer, default=0)
    """Runners in a row that ended without an episode finished."""
    created: Mapped[float] = mapped_column(Double)
    started: Mapped[float | None] = mapped_column(Double)
    """When it began to run."""
    ended: Mapped[float | None] = mapped_column(Double)
    """When it finished, failed or was cancelled."""
    owner: Mapped[OwnerRow] = relationship(lazy="joined")

    @property
    def names(self) -> tuple[str, str]:
        """Who takes turns with others for it, see :func:`names_of`."""
        return names_of(self.owner_id, self.owner.origin)


class SubmissionLogRow(Base):
    """One line of a submission's log."""

    __tablename__ = "submission_log"

    submission_id: Mapped[str] = _of("submissions", primary_key=True)
    number: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    """From 1."""
    time: Mapped[float] = mapped_column(Double)
    message: Mapped[str] = mapped_column(Text)


class HeldRow(Base):
    """What stays taken after the operator has deleted its holder: a name, or an agent's place on a suite."""

    __tablename__ = "held"

    kind: Mapped[str] = mapped_column(_WORD, primary_key=True)
    """``owner`` or ``agent`` for a name, ``evaluation`` for a suite."""
    key: Mapped[str] = mapped_column(String(128), primary_key=True)
    """The name in lower case, or the agent's id and the suite."""
    agent_id: Mapped[str | None] = _of("agents", index=True)
    """The agent whose place it is. None for a name."""
    deleted: Mapped[str] = mapped_column(_ID, index=True)
    """Id of what was deleted."""


class AuditRow(Base):
    """What the operator did. The row stays when its target is deleted."""

    __tablename__ = "audit"

    seq: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    """From 1."""
    time: Mapped[float] = mapped_column(Double)
    actor: Mapped[str] = mapped_column(_WORD)
    """``operator``, and the first digits of the SHA-256 of the token that was sent."""
    address: Mapped[str] = mapped_column(String(64))
    """Where the call came from."""
    action: Mapped[str] = mapped_column(_WORD)
    kind: Mapped[str] = mapped_column(_WORD)
    """What the target is: an owner, an agent, an evaluation, a submission or a key."""
    target: Mapped[str] = mapped_column(_ID, index=True)
    name: Mapped[str] = mapped_column(String(160))
    reason: Mapped[str | None] = mapped_column(Text)
    """Why, as the operator says."""
    counts: Mapped[str] = mapped_column(Text)
    """JSON: how many rows of each kind were changed."""


class SigningKeyRow(Base):
    """A key that signs certificates, or has signed some. A retired one has no private part."""

    __tablename__ = "signing_keys"

    seq: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    """From 1. The last one signs."""
    public: Mapped[str] = mapped_column(_SHA, unique=True)
    """The 32 bytes, hexadecimal."""
    private: Mapped[bytes | None] = mapped_column(LargeBinary)
    """The 32 bytes. None if it is retired, or kept in a file."""
    created: Mapped[float] = mapped_column(Double)
    retired: Mapped[float | None] = mapped_column(Double)


class ProbeRow(Base):
    """What the service writes after a failure, to find out whether the database works again. One row."""

    __tablename__ = "probe"

    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    data: Mapped[bytes] = mapped_column(LargeBinary)


class OwnershipRow(Base):
    """The service that uses the database: one row, needed on a server, where there is no file to lock."""

    __tablename__ = "ownership"

    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    holder: Mapped[str] = mapped_column(_ID)
    since: Mapped[float] = mapped_column(Double)
