"""Registration of owners and agents: who may, how many, and which owner an agent gets."""

import time
from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import Final

from wrongturn_protocol import AgentKind, AgentRegistration, FieldError, OwnerDetail, OwnerRegistration, ProblemType
from wrongturn_protocol.reserved_names import OWNER_NAME, looks_like, misleads
from wrongturn_service.accounts import Accounts
from wrongturn_service.errors import ConflictError, ForbiddenError, UnavailableError
from wrongturn_service.settings import Registration, Settings
from wrongturn_service.storage.accounts import AgentNameTakenError, OwnerNameTakenError
from wrongturn_service.storage.models import AgentRow, IdempotencyRow, OwnerRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import digest, new_id

SHIPPED: Final = OWNER_NAME
"""Owner of the agents that the operator registers as other kinds than ``submitted``."""
_HOUR_S = 3600.0
_ADDRESSES = 10_000


@dataclass(frozen=True)
class Registrant:
    """Who registers an owner or an agent.

    Attributes:
        owner: The owner whose token was sent. None for the operator and without a token.
        address: The address that the request comes from.
        operator: Whether the operator's token was sent.
    """

    owner: OwnerRow | None
    address: str
    operator: bool = False

    @property
    def scope(self) -> str:
        """Whose an ``Idempotency-Key`` is: the token's, or without a token the address's."""
        if self.owner is not None:
            return self.owner.id
        return "operator" if self.operator else f"registration {self.address}"

    @property
    def origin(self) -> str | None:
        """Whose quota a new owner counts to: its address's, or nobody's if the operator registers it."""
        return None if self.operator else self.address


class Registrations:
    """Registers owners and agents."""

    def __init__(self, store: Store, settings: Settings, accounts: Accounts) -> None:
        self._store = store
        self._settings = settings
        self._accounts = accounts
        self._times: OrderedDict[str, deque[float]] = OrderedDict()
        """When each address has registered owners and agents within the last hour."""

    async def prepare(self) -> None:
        """Make the owner of the shipped agents, so that nobody else has or takes its name."""
        await self._store.reserve_owner(new_owner(SHIPPED))

    async def registrant(self, authorization: str | None, address: str, advice: str) -> Registrant:
        """Return who registers. ``advice`` says what to do instead of sending an agent's token.

        Raises UnauthenticatedError; ForbiddenError for an agent's token, or a runner's.
        """
        operator = self._accounts.is_operator(authorization)
        if authorization is None or operator:
            return Registrant(None, address, operator=operator)
        holder = await self._accounts.holder(authorization, "; leave it out, or correct it")
        if not isinstance(holder, OwnerRow):
            raise ForbiddenError(f"this is an agent's token; {advice}")
        return Registrant(holder, address)

    def check_agent(self, registration: AgentRegistration, who: Registrant) -> None:
        """Check whether an agent may be registered. Raises ForbiddenError, ConflictError, UnavailableError."""
        if who.operator:
            return
        if registration.kind is not AgentKind.SUBMITTED:
            raise ForbiddenError(f"kind: {registration.kind} needs the operator's token; leave it out")
        if who.owner is None:
            self._check_open("agents", "ask the operator for an owner's token")
        self.check_agent_name(registration.name)
        if who.owner is None:  # an owner has a limit of its own on agents
            self._count(who.address)

    def check_agent_name(self, name: str) -> None:
        """Check that a name is not kept for the operator. Raises ConflictError.

        Without an operator, nobody else could register the shipped agents.
        """
        shipped = looks_like(name) if self._settings.operator.required else None
        why = misleads(name) if shipped is None else f"the agent {shipped} comes with Wrongturn"
        if why is not None:
            message = f"{name!r} is reserved: {why}; choose another"
            raise ConflictError(
                ProblemType.AGENT_NAME_TAKEN, f"name: {message}", errors=[FieldError(path="name", message=message)]
            )

    def check_owner(self, registration: OwnerRegistration, who: Registrant) -> None:
        """Check whether an owner may be registered. Raises ForbiddenError, ConflictError, UnavailableError."""
        if not who.operator:
            self._check_open("owners", "ask the operator to register you")
            _check_owner_name(registration.name)
            self._count(who.address)

    def _count(self, address: str) -> None:
        """Count a registration from an address. Raises UnavailableError beyond the limit."""
        now, limit = time.monotonic(), self._settings.registration_limit
        times = self._times.setdefault(address, deque())
        self._times.move_to_end(address)
        while len(self._times) > _ADDRESSES:
            self._times.popitem(last=False)
        while times and now - times[0] > _HOUR_S:
            times.popleft()
        if len(times) >= limit:
            wait = int(_HOUR_S - (now - times[0])) + 1
            raise UnavailableError(
                ProblemType.RATE_LIMITED,
                f"this address has registered {limit} owners and agents within an hour, the limit; come back in "
                f"{wait} s, register agents with an owner's token, which does not count here, or ask the operator to "
                "register you or to raise WRONGTURN_REGISTRATION_LIMIT",
                retry_after_s=wait,
                status=429,
            )
        times.append(now)

    def _check_open(self, what: str, remedy: str) -> None:
        if self._settings.registration is Registration.OPERATOR:
            raise ForbiddenError(f"only the operator registers {what} here; {remedy}", ProblemType.REGISTRATION_CLOSED)

    async def owner_for(self, registration: AgentRegistration, who: Registrant) -> OwnerRow:
        """Return the owner of an agent that is about to be registered.

        An agent that no owner registers belongs to :data:`SHIPPED` if it is shipped, else to a new owner of its name.
        """
        if who.owner is not None:
            return who.owner
        if registration.kind is not AgentKind.SUBMITTED:
            shipped = await self._store.owner_by_name(SHIPPED.lower())
            assert shipped is not None
            return shipped
        _check_owner_name(registration.name)
        return new_owner(registration.name, origin=who.origin)

    async def add_agent(self, row: AgentRow, reply: IdempotencyRow | None) -> None:
        """Store a new agent, and its owner if that is new. Raises ConflictError."""
        try:
            await self._store.add_agent(row, reply)
        except AgentNameTakenError as error:
            message = f"name: {row.name!r} is taken; choose another (a new model is a new agent)"
            raise ConflictError(ProblemType.AGENT_NAME_TAKEN, message) from error
        except OwnerNameTakenError as error:
            message = f"name: an owner is called {row.name!r}; choose another name, or send that owner's token"
            raise ConflictError(ProblemType.OWNER_NAME_TAKEN, message) from error

    async def add_owner(self, row: OwnerRow, reply: IdempotencyRow | None) -> None:
        """Store a new owner. Raises ConflictError."""
        try:
            await self._store.add_owner(row, reply)
        except OwnerNameTakenError as error:
            message = f"name: {row.name!r} is taken by another owner; choose another"
            raise ConflictError(ProblemType.OWNER_NAME_TAKEN, message) from error


def _check_owner_name(name: str) -> None:
    shipped = looks_like(name, frozenset({SHIPPED})) is not None
    why = f"{SHIPPED} is the owner of the shipped agents" if shipped else misleads(name)
    if why is not None:
        raise ConflictError(ProblemType.OWNER_NAME_TAKEN, f"name: {name!r} is reserved: {why}; choose another")


def new_owner(name: str, contact: str | None = None, token: str | None = None, origin: str | None = None) -> OwnerRow:
    """Return the row of a new owner."""
    return OwnerRow(
        id=new_id("ow"),
        name=name,
        name_key=name.lower(),
        contact=contact,
        token_sha256=None if token is None else digest(token),
        created=time.time(),
        origin=origin,
    )


def owner_detail(row: OwnerRow) -> OwnerDetail:
    """Return an owner's public details. The contact is none of them."""
    return OwnerDetail(id=row.id, name=row.name)
