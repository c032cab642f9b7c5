"""Agents and their tokens, the operator, and limits on registration."""

import asyncio
import time
from collections import OrderedDict, deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from wrongturn_protocol import AgentDetail, AgentKind, AgentRegistration, ProblemType, Track
from wrongturn_service.errors import (
    ConflictError,
    ForbiddenError,
    NotFoundError,
    UnauthenticatedError,
    UnavailableError,
)
from wrongturn_service.settings import Registration, Settings
from wrongturn_service.storage.models import AgentRow, EvaluationRow, IdempotencyRow
from wrongturn_service.storage.store import NameTakenError, Store
from wrongturn_service.tokens import digest, same

_HOUR_S = 3600.0
_CACHED = 10_000
_EVALUATION_S = 60
"""Retry-After for an agent that has too many running evaluations, seconds."""


@dataclass(frozen=True, slots=True)
class Caller:
    """The agent whose token a call holds."""

    id: str
    track: Track


class AddressLimit:
    """Limit on registrations from one address within an hour."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._times: OrderedDict[str, deque[float]] = OrderedDict()

    def check(self, address: str) -> None:
        """Count a registration. Raises UnavailableError beyond the limit."""
        now = time.monotonic()
        times = self._times.setdefault(address, deque())
        self._times.move_to_end(address)
        while len(self._times) > _CACHED:
            self._times.popitem(last=False)
        while times and now - times[0] > _HOUR_S:
            times.popleft()
        if len(times) >= self._limit:
            wait = int(_HOUR_S - (now - times[0])) + 1
            raise UnavailableError(
                ProblemType.RATE_LIMITED,
                f"this address has registered {self._limit} agents within an hour, the limit; come back in {wait} s",
                retry_after_s=wait,
                status=429,
            )
        times.append(now)


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
        self._limit = AddressLimit(settings.registration_limit)
        self._callers: OrderedDict[str, Caller] = OrderedDict()
        self._changes = 0
        self._beginning = asyncio.Lock()

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
                raise UnauthenticatedError("no agent has this token; it may have been rotated or revoked")
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

    def check_registration(self, registration: AgentRegistration, *, operator: bool, address: str) -> None:
        """Check whether a registration is allowed. Raises ForbiddenError, UnavailableError."""
        if operator:
            return
        if self._settings.registration is Registration.OPERATOR:
            raise ForbiddenError(
                "only the operator registers agents here; ask the operator for a token",
                ProblemType.REGISTRATION_CLOSED,
            )
        if registration.kind is not AgentKind.SUBMITTED:
            raise ForbiddenError(f"kind: {registration.kind} needs the operator's token; leave it out")
        self._limit.check(address)

    async def register(self, row: AgentRow, reply: IdempotencyRow | None) -> None:
        """Store a new agent. Raises ConflictError."""
        try:
            await self._store.add_agent(row, reply)
        except NameTakenError as error:
            raise ConflictError(
                ProblemType.AGENT_NAME_TAKEN,
                f"name: {row.name!r} is taken; choose another (a new model is a new agent)",
            ) from error

    async def begin_evaluation(self, row: EvaluationRow, reply: IdempotencyRow | None) -> None:
        """Store a new evaluation. Raises UnavailableError if too many of the agent's are running."""
        limit = self._settings.max_evaluations
        async with self._beginning:
            if await self._store.running_count(row.agent_id) >= limit:
                raise UnavailableError(
                    ProblemType.RATE_LIMITED,
                    f"this agent has {limit} running evaluations, which is the limit; finish one, or cancel it by "
                    "DELETE /v1/evaluations/{id}",
                    retry_after_s=_EVALUATION_S,
                    status=429,
                    position=1,
                )
            await self._store.add_evaluation(row, reply)

    async def agent(self, agent_id: str) -> AgentRow:
        """Return an agent. Raises NotFoundError."""
        row = await self._store.agent(agent_id)
        if row is None:
            raise NotFoundError(ProblemType.UNKNOWN_AGENT, f"there is no agent {agent_id[:64]!r}")
        return row

    async def owned_agent(self, agent_id: str, authorization: str | None) -> AgentRow:
        """Return an agent to itself or the operator. Raises UnauthenticatedError, ForbiddenError, NotFoundError."""
        operator = self.is_operator(authorization)
        caller = None if operator else await self.caller(authorization)
        row = await self.agent(agent_id)
        if caller is not None and caller.id != agent_id:
            raise ForbiddenError(f"this is not the token of agent {agent_id}")
        return row

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
        description=row.description,
        homepage=row.homepage,
    )
