"""Who calls: owners, agents, the runners of submissions, and the operator. Tokens are stored as SHA-256 only."""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from wrongturn_protocol import (
    AgentDetail,
    AgentKind,
    Entry,
    EvaluationState,
    PracticeRequest,
    ProblemType,
    Rig,
    Sight,
    SubmissionState,
    Track,
)
from wrongturn_protocol.rigs import rig_of
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.errors import ForbiddenError, InvalidRequestError, UnauthenticatedError, unknown
from wrongturn_service.settings import Settings
from wrongturn_service.storage.models import (
    AgentRow,
    EpisodeRow,
    EvaluationRow,
    IdempotencyRow,
    OwnerRow,
    SubmissionRow,
)
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.submissions import SubmissionStore
from wrongturn_service.tokens import digest, new_token

_CACHED = 10_000


@dataclass(frozen=True, slots=True)
class Caller:
    """Who makes a call: an agent, or the runner that drives the agent of a submission.

    Attributes:
        id: Id of the agent.
        track: Track of the agent.
        owner: Id of the agent's owner.
        submission: Id of the submission whose runner calls. None for the agent itself.
        evaluation: The one evaluation that the runner may drive. None while it checks the model: then it may practise.
        rig: The agent's rig; None: what its track shows.
    """

    id: str
    track: Track
    owner: str
    submission: str | None = None
    evaluation: str | None = None
    rig: Rig | None = None

    @property
    def sight(self) -> Sight:
        """What the agent is shown."""
        return self.rig or self.track

    @property
    def holder(self) -> str:
        """Id of who holds the token: the agent, or the submission. Open episodes, keys and limits are the holder's."""
        return self.submission or self.id

    def check_agent(self) -> None:
        """Check that the agent itself calls. Raises ForbiddenError."""
        if self.submission is not None:
            raise ForbiddenError(f"{self._scope}; this call needs another token")

    def check_practice(self) -> None:
        """Check that the caller may practise. Raises ForbiddenError."""
        if self.evaluation is not None:
            raise ForbiddenError(f"{self._scope}; practise with the agent's own token")

    def check_sees(self, row: EvaluationRow) -> None:
        """Check that an evaluation is the caller's. Raises ForbiddenError."""
        if row.agent_id != self.id:
            raise ForbiddenError(f"evaluation {row.id} belongs to another agent")
        if self.submission is not None and row.id != self.evaluation:
            raise ForbiddenError(f"{self._scope}, not for evaluation {row.id}")

    def check_drives(self, row: EvaluationRow) -> None:
        """Check that the caller may drive an evaluation, or close it. Raises ForbiddenError."""
        self.check_sees(row)
        uploaded = row.entry == Entry.UPLOADED and row.state == EvaluationState.RUNNING
        if uploaded and self.submission is None:
            raise ForbiddenError(
                f"evaluation {row.id} is of a model that was handed in, and the service drives it; to stop it, cancel "
                "its submission: DELETE /v1/submissions/{id}"
            )

    def check_episode(self, row: EpisodeRow) -> None:
        """Check that an episode is the caller's. Raises ForbiddenError."""
        if row.agent_id != self.id:
            raise ForbiddenError(f"episode {row.id} belongs to another agent")
        if self.submission is not None and row.evaluation_id != self.evaluation:
            raise ForbiddenError(f"{self._scope}, not for episode {row.id}")

    @property
    def _scope(self) -> str:
        what = "its check" if self.evaluation is None else f"evaluation {self.evaluation}"
        return f"this token of submission {self.submission} is valid only for {what}"

    def check_track(self, request: PracticeRequest) -> None:
        """Check that practice is in the agent's own track. Raises InvalidRequestError.

        Another track would show what the agent's own one hides.
        """
        if request.track is not None and request.track is not self.track:
            raise InvalidRequestError(
                "track",
                f"is {request.track}, and this agent's track is {self.track}; leave it out, or register an agent for "
                f"the track {request.track}",
                ProblemType.TRACK_NOT_AVAILABLE,
            )


@dataclass(frozen=True, slots=True)
class Submitter:
    """Who calls about submissions: an owner, one of its agents, or the operator.

    Attributes:
        owner: The owner. None for the operator.
        agent: The agent whose token was sent. None for an owner and the operator.
    """

    owner: OwnerRow | None
    agent: AgentRow | None = None

    @property
    def id(self) -> str:
        """Id of who holds the token."""
        holder = self.agent or self.owner
        return "operator" if holder is None else holder.id

    def check_sees(self, row: SubmissionRow) -> None:
        """Check that a submission is the caller's. Raises ForbiddenError."""
        if self.agent is not None and row.agent_id != self.agent.id:
            raise ForbiddenError(f"submission {row.id} belongs to another agent")
        if self.owner is not None and row.owner_id != self.owner.id:
            raise ForbiddenError(f"submission {row.id} belongs to another owner")


class Accounts:
    """Owners and agents by their tokens."""

    def __init__(self, store: Store, submissions: SubmissionStore, settings: Settings) -> None:
        """Create the accounts. From now on they learn when a runner's token ends."""
        self._store = store
        self._submissions = submissions
        submissions.token_ended = self._forget
        self._settings = settings
        self._callers: OrderedDict[str, Caller] = OrderedDict()
        """Those who called last, by their ``Authorization`` header."""
        self.changes = 0
        """Number of tokens that became invalid so far. While it is the same, known callers are still valid."""

    async def caller(self, authorization: str | None) -> Caller:
        """Return the agent, or the runner, whose token an ``Authorization`` header holds. Raises UnauthenticatedError.

        A runner's token is valid only for its submission: the call has to check it.
        """
        found = self._callers.get(authorization or "")
        if found is None:
            changes = self.changes
            found = await self._find(digest(bearer(authorization)))
            if found is None:
                raise UnauthenticatedError(
                    "no agent has this token; it may have been rotated or revoked, or is an owner's"
                )
            # If a token changed while this was read, the result is good for this call only.
            if changes == self.changes and authorization is not None:
                self._callers[authorization] = found
            while len(self._callers) > _CACHED:
                self._callers.popitem(last=False)
        return found

    async def _find(self, token_sha256: str) -> Caller | None:
        row = await self._store.agent_by_token(token_sha256)
        if row is None:
            return await self._runner(token_sha256)
        return Caller(row.id, Track(row.track), row.owner_id, rig=rig_of(row.rig))

    async def _runner(self, token_sha256: str) -> Caller | None:
        row = await self._submissions.by_token(token_sha256)
        if row is None or row.agent_id is None or row.track is None:
            return None
        running = row.state == SubmissionState.RUNNING
        if running is (row.evaluation_id is None):
            return None  # its evaluation was deleted, or it is being moved
        agent = await self._store.agent(row.agent_id)
        rig = None if agent is None else rig_of(agent.rig)
        return Caller(row.agent_id, Track(row.track), row.owner_id, row.id, row.evaluation_id, rig)

    async def submitter(self, authorization: str | None) -> Submitter:
        """Return who calls about submissions. Raises UnauthenticatedError; ForbiddenError for a runner's token."""
        if self.is_operator(authorization):
            return Submitter(None)
        holder = await self.holder(authorization)
        return Submitter(holder) if isinstance(holder, OwnerRow) else Submitter(holder.owner, holder)

    async def holder(self, authorization: str | None, remedy: str = "") -> OwnerRow | AgentRow:
        """Return the owner or the agent whose token an ``Authorization`` header holds.

        Raises:
            UnauthenticatedError: There is no token, or nobody has it; then the message ends with the remedy.
            ForbiddenError: It is a runner's token.
        """
        token_sha256 = digest(bearer(authorization))
        found = await self._store.owner_by_token(token_sha256) or await self._store.agent_by_token(token_sha256)
        if found is not None:
            return found
        runner = await self._runner(token_sha256)
        if runner is not None:
            runner.check_agent()
        raise UnauthenticatedError(f"nobody has this token; it may have been rotated or revoked{remedy}")

    def is_operator(self, authorization: str | None) -> bool:
        """Return whether an ``Authorization`` header holds the operator's token."""
        scheme, _, token = (authorization or "").partition(" ")
        return scheme.lower() == "bearer" and self._settings.operator.is_(token.strip())

    async def operator(self, authorization: str | None) -> str:
        """Return who calls as the operator: with the first digits of the SHA-256 of its token, which tell tokens apart.

        Raises UnauthenticatedError; ForbiddenError for another's token.
        """
        token = bearer(authorization)
        if self.is_operator(authorization):
            return f"operator {digest(token)[:8]}"
        await self.submitter(authorization)
        raise ForbiddenError("this call needs the operator's token")

    async def _item(self, collection: Collection, item_id: str) -> OwnerRow | AgentRow:
        """Return an owner or an agent. Raises NotFoundError."""
        row = await (self._store.owner if collection is Collection.OWNERS else self._store.agent)(item_id)
        if row is None:
            raise unknown(collection, item_id)
        return row

    async def shown(self, collection: Collection, item_id: str, authorization: str | None) -> OwnerRow | AgentRow:
        """Return an owner or an agent to everybody; a hidden one to itself, its owner and the operator.

        Raises NotFoundError.
        """
        row = await self._item(collection, item_id)
        hidden = row.hidden if isinstance(row, OwnerRow) else row.unseen
        if hidden and not await self.holds(authorization, row):
            raise unknown(collection, item_id)
        return row

    async def holds(self, authorization: str | None, row: OwnerRow | AgentRow) -> bool:
        """Return whether a header holds the token of an owner, of an agent or its owner, or the operator's."""
        try:
            return self.is_operator(authorization) or (await self.holder(authorization)).id in _holders(row)
        except (UnauthenticatedError, ForbiddenError):
            return False

    async def owns(self, authorization: str | None, agent_id: str) -> bool:
        """Return whether a header holds an agent's token, its owner's or the operator's."""
        row = await self._store.agent(agent_id)
        return row is not None and await self.holds(authorization, row)

    async def own(self, collection: Collection, item_id: str, authorization: str | None) -> OwnerRow | AgentRow:
        """Return an owner or an agent to itself, its owner or the operator.

        Raises UnauthenticatedError, ForbiddenError, NotFoundError.
        """
        caller = None if self.is_operator(authorization) else (await self.holder(authorization)).id
        row = await self._item(collection, item_id)
        if caller is not None and caller not in _holders(row):
            others = "or the operator's" if isinstance(row, OwnerRow) else "its owner's, or the operator's"
            raise ForbiddenError(
                f"this is not the token of {collection.one} {item_id}; send this {collection.one}'s own token, {others}"
            )
        return row

    async def set_token(self, row: OwnerRow | AgentRow, token: str | None, reply: IdempotencyRow | None = None) -> None:
        """Replace the token of an owner or an agent. None revokes it."""
        await self._store.set_token(row, None if token is None else digest(token), reply)
        await self._forget(row.id)

    async def renew(self, reply: IdempotencyRow) -> str:
        """Return a new token in place of the one that a stored reply had, which ends."""
        token = new_token()
        await self._store.renew_token(reply, digest(token))
        await self._forget(reply.agent_id or reply.owner_id)
        return token

    async def forget(self, holders: Iterable[str]) -> None:
        """Forget the tokens of agents and runners that were ended in the database."""
        for holder in holders:
            await self._forget(holder)

    async def _forget(self, holder: str) -> None:
        """Forget whose tokens are known, and look at each connection's token again."""
        self.changes += 1
        for known, caller in list(self._callers.items()):
            if caller.holder == holder:
                del self._callers[known]


def _holders(row: OwnerRow | AgentRow) -> set[str]:
    """Return the ids of those to whom an owner or an agent belongs."""
    return {row.id} if isinstance(row, OwnerRow) else {row.id, row.owner_id}


def bearer(authorization: str | None) -> str:
    """Return the token of an ``Authorization`` header. Raises UnauthenticatedError."""
    scheme, _, token = (authorization or "").partition(" ")
    token = token.strip()
    if scheme.lower() != "bearer" or not token:
        raise UnauthenticatedError(
            "this call needs a token: send 'Authorization: Bearer …' with an owner's token from POST /v1/owners, or "
            "an agent's from POST /v1/agents; /openapi.json says which a call takes"
        )
    return token


def detail(row: AgentRow) -> AgentDetail:
    """Return an agent's public details."""
    return AgentDetail(
        id=row.id,
        name=row.name,
        track=Track(row.track),
        kind=AgentKind(row.kind),
        owner=row.owner.name,
        description=row.description,
        homepage=row.homepage,
        trained_on_faults=bool(row.trained_on_faults),
        rig=rig_of(row.rig),
    )
