"""The calls about owners, agents and their tokens."""

import reprlib
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from wrongturn_client.rest import RestCalls
from wrongturn_client.transport import path_of
from wrongturn_protocol import (
    AgentDetail,
    AgentKind,
    AgentList,
    AgentRegistration,
    OwnerDetail,
    OwnerList,
    OwnerRegistration,
    RegisteredAgent,
    RegisteredOwner,
    Track,
)
from wrongturn_protocol.suggestions import did_you_mean

M = TypeVar("M", bound=BaseModel)


class AccountCalls(RestCalls):
    """Registers owners and agents, and looks after their tokens."""

    def register_owner(self, name: str, *, contact: str | None = None) -> RegisteredOwner:
        """Register an owner, who answers for agents. Its token is shown only now.

        A client with that token registers agents for the owner, and rotates and revokes their tokens.

        Args:
            name: Shown beside the owner's agents.
            contact: How the operator reaches the owner; nobody else sees it.

        Raises:
            ValueError: The name or the contact is not valid; the message names it.
        """
        registration = _checked(OwnerRegistration, name=name, contact=contact)
        return self._create(RegisteredOwner, registration.model_dump(mode="json"), "owners")

    def owners(self) -> tuple[OwnerDetail, ...]:
        """Return all owners."""
        return tuple(owner for page in self._pages(OwnerList, "owners") for owner in page.owners)

    def owner(self, owner: str) -> OwnerDetail:
        """Return an owner by its id."""
        return self._get(OwnerDetail, "owners", owner)

    def rotate_owner_token(self, owner: str) -> RegisteredOwner:
        """Replace an owner's token; the old one becomes invalid. This client keeps using the old one."""
        return self._create(RegisteredOwner, None, "owners", owner, "token")

    def revoke_owner_token(self, owner: str) -> None:
        """Make an owner's token invalid."""
        self._transport.call("DELETE", path_of("v1", "owners", owner, "token"))

    def register(
        self,
        name: str,
        track: Track | str,
        *,
        description: str | None = None,
        homepage: str | None = None,
        kind: AgentKind = AgentKind.SUBMITTED,
        trained_on_faults: bool = False,
    ) -> RegisteredAgent:
        """Register an agent. Its token is shown only now. Other kinds than ``submitted`` need the operator's token.

        With an owner's token the agent is that owner's. Without a token an owner of the agent's name is made. Say with
        ``trained_on_faults`` that it met wrong commands in its training; the leaderboard marks it.

        Raises:
            ValueError: The name, the track or another argument is not valid; the message names it.
        """
        registration = _checked(
            AgentRegistration,
            name=name,
            track=track,
            description=description,
            homepage=homepage,
            kind=kind,
            trained_on_faults=trained_on_faults,
        )
        return self._create(RegisteredAgent, registration.model_dump(mode="json"), "agents")

    def agents(self, *, everybody: bool = False) -> tuple[AgentDetail, ...]:
        """Return the agents that have begun an evaluation.

        Args:
            everybody: Whether to return those that have only practised too.
        """
        query = {"all": "true"} if everybody else {}
        return tuple(agent for page in self._pages(AgentList, "agents", **query) for agent in page.agents)

    def agent(self, agent: str) -> AgentDetail:
        """Return an agent by its id."""
        return self._get(AgentDetail, "agents", agent)

    def rotate_token(self, agent: str) -> RegisteredAgent:
        """Replace an agent's token; the old one becomes invalid. This client keeps using the old one."""
        return self._create(RegisteredAgent, None, "agents", agent, "token")

    def revoke_token(self, agent: str) -> None:
        """Make an agent's token invalid."""
        self._transport.call("DELETE", path_of("v1", "agents", agent, "token"))


def _checked(registration: type[M], /, **fields: Any) -> M:
    """Return a registration. The error for a wrong one is one line about its first wrong field."""
    try:
        return registration(**fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = str(first["loc"][0])
        rule = f"give {', '.join(Track)}{did_you_mean(first['input'], Track)}" if field == "track" else first["msg"]
        raise ValueError(f"{field}: is {reprlib.repr(first['input'])}; {rule}") from error
