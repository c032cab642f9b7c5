"""Agents and their tokens, and the operator."""

from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from wrongturn_protocol import AgentDetail, AgentKind, PracticeRequest, ProblemType, Track
from wrongturn_service.errors import (
    ForbiddenError,
    InvalidRequestError,
    NotFoundError,
    UnauthenticatedError,
)
from wrongturn_service.settings import Settings
from wrongturn_service.storage.models import AgentRow, IdempotencyRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import digest, same

_CACHED = 10_000


@dataclass(frozen=True, slots=True)
class Caller:
    """The agent whose token a call holds."""

    id: str
    track: Track

    def practice_track(self, request: PracticeRequest) -> Track:
        """Return the track of a practice episode, which is the agent's own.

        Another track would show what the agent's own one hides. Raises InvalidRequestError.
        """
        if request.track is not None and request.track is not self.track:
            raise InvalidRequestError(
                "track",
                f"is {request.track}, and this agent's track is {self.track}; leave it out, or register an agent for "
                f"the track {request.track}",
                ProblemType.TRACK_NOT_AVAILABLE,
            )
        return self.track


class Accounts:
    """Agents and their tokens. Tokens are stored as SHA-256 only."""

    def __init__(self, store: Store, settings: Settings, changed: Callable[[], Awaitable[None]]) -> None:
        """Create the accounts.

        Args:
            store: Holds the agents.
            settings: Settings of the service.
            changed: Awaited after a token became invalid.
        """
        self._changed = changed
        self._store = store
        self._settings = settings
        self._callers: OrderedDict[str, Caller] = OrderedDict()
        self._changes = 0

    @property
    def changes(self) -> int:
        """Number of tokens that became invalid so far. While it is the same, known callers are still valid."""
        return self._changes

    async def caller(self, authorization: str | None) -> Caller:
        """Return the agent whose token an ``Authorization`` header holds.

        Raises:
            UnauthenticatedError: There is no token, or no agent has it.
        """
        token_sha256 = digest(bearer(authorization))
        found = self._callers.get(token_sha256)
        if found is None:
            changes = self._changes
            row = await self._store.agent_by_token(token_sha256)
            if row is None:
                raise UnauthenticatedError(
                    "no agent has this token; it may have been rotated or revoked, or is an owner's"
                )
            found = Caller(row.id, Track(row.track))
            # If a token changed while this was read, the result is good for this call only.
            if changes == self._changes:
                self._callers[token_sha256] = found
            while len(self._callers) > _CACHED:
                self._callers.popitem(last=False)
        return found

    def is_operator(self, authorization: str | None) -> bool:
        """Return whether an ``Authorization`` header holds the operator's token."""
        secret = self._settings.operator_token
        if secret is None or authorization is None:
            return False
        scheme, _, token = authorization.partition(" ")
        return scheme.lower() == "bearer" and same(token.strip(), secret.get_secret_value())

    async def agent(self, agent_id: str) -> AgentRow:
        """Return an agent. Raises NotFoundError."""
        row = await self._store.agent(agent_id)
        if row is None:
            raise NotFoundError(ProblemType.UNKNOWN_AGENT, f"there is no agent {agent_id[:64]!r}")
        return row

    async def owned_agent(self, agent_id: str, authorization: str | None) -> AgentRow:
        """Return an agent to itself, its owner or the operator.

        Raises:
            UnauthenticatedError, ForbiddenError, NotFoundError.
        """
        holder = None if self.is_operator(authorization) else await self._holder(authorization)
        row = await self.agent(agent_id)
        if holder is not None and holder not in {row.id, row.owner_id}:
            raise ForbiddenError(f"this is neither the token of agent {agent_id} nor its owner's")
        return row

    async def _holder(self, authorization: str | None) -> str:
        """Return the id of the owner or agent that has a token. Raises UnauthenticatedError."""
        owner = await self._store.owner_by_token(digest(bearer(authorization)))
        return owner.id if owner is not None else (await self.caller(authorization)).id

    async def set_token(self, agent_id: str, token: str | None, reply: IdempotencyRow | None = None) -> None:
        """Replace an agent's token. None revokes it."""
        await self._store.set_token(agent_id, None if token is None else digest(token), reply)
        self._changes += 1
        for known, caller in list(self._callers.items()):
            if caller.id == agent_id:
                del self._callers[known]
        await self._changed()


def bearer(authorization: str | None) -> str:
    """Return the token of an ``Authorization`` header. Raises UnauthenticatedError."""
    scheme, _, token = (authorization or "").partition(" ")
    token = token.strip()
    if scheme.lower() != "bearer" or not token:
        raise UnauthenticatedError(
            "this call needs a token: send 'Authorization: Bearer …' with the one from POST /v1/agents",
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
    )
