"""REST calls with typed replies: those that need no token, and those about owners, agents and their tokens."""

import reprlib
import sys
import uuid
from collections.abc import Iterator
from typing import Any, Final, TypeVar
from urllib.parse import urlencode

from pydantic import BaseModel, ValidationError

import wrongturn_protocol as protocol
from wrongturn_client.episode_calls import validated
from wrongturn_client.errors import ProtocolError
from wrongturn_client.transport import CSV, Transport, path_of
from wrongturn_protocol.rigs import rig_of
from wrongturn_protocol.suggestions import did_you_mean

M = TypeVar("M", bound=BaseModel)
_PAGE: Final = 500
"""Items of a list that are asked for at a time."""


class RestCalls:
    """Base of what calls a service."""

    _transport: Transport

    @property
    def url(self) -> str:
        """The service's URL."""
        return self._transport.url

    def _call(self, kind: type[M], method: str, *path: str, **query: Any) -> M:
        """Send a call without a body and return its reply; None leaves a part of the query out."""
        given = [(name, value) for name, value in query.items() if value is not None]
        asked = urlencode([(name, str(value).lower() if isinstance(value, bool) else value) for name, value in given])
        reply = self._transport.call(method, path_of("v1", *path) + (f"?{asked}" if asked else ""))
        return validated(kind, reply.message())

    def _get(self, kind: type[M], *path: str, **query: Any) -> M:
        return self._call(kind, "GET", *path, **query)

    def _pages(self, kind: type[M], *path: str, most: int = sys.maxsize, **query: Any) -> Iterator[M]:
        """Yield the pages of a list, each when the one before was read, until there are ``most`` items."""
        for left in range(most, 0, -_PAGE):
            page: Any = self._get(kind, *path, limit=min(left, _PAGE), **query)
            yield page
            if page.next is None:
                return
            query["cursor"] = page.next

    def _create(self, kind: type[M], body: Any, *path: str) -> M:
        answer = self._transport.call("POST", path_of("v1", *path), body=body, key=str(uuid.uuid4()))
        return validated(kind, answer.message())


class TypedCalls(RestCalls):
    """What anybody may ask a service, and what looks after owners, agents and their tokens."""

    def live(self) -> bool:
        """Return True if the service's process answers."""
        self._transport.call("GET", "/health/live")
        return True

    def ready(self) -> bool:
        """Return True once the service can take episodes; wait for the patience at most."""
        self._transport.call("GET", "/health/ready")
        return True

    def submissions_state(self) -> str | None:
        """Return whether the service takes submissions: ``on: …``, or ``off:`` and why; None if it does not say."""
        state = self._readiness().get("submissions")
        return state if isinstance(state, str) else None

    def simulators(self) -> int | None:
        """Return how many episodes all agents together can drive at a time; None if the service does not say."""
        number = self._readiness().get("simulators")
        return number if isinstance(number, int) else None

    def _readiness(self) -> dict[str, Any]:
        found = self._transport.call("GET", "/health/ready").message()
        return found if isinstance(found, dict) else {}

    def suites(self) -> tuple[protocol.SuiteSummary, ...]:
        """Return all suites."""
        return self._get(protocol.SuiteList, "suites").suites

    def suite(self, suite: str) -> protocol.SuiteDetail:
        """Return a suite by its id, such as ``wrong-command@3``."""
        return self._get(protocol.SuiteDetail, "suites", suite)

    def trials(self, suite: str) -> tuple[protocol.TrialDetail, ...]:
        """Return the trials of a suite's open split, for practice. You can practise their twins too."""
        return self._get(protocol.TrialList, "suites", suite, "trials").trials

    def towns(self) -> tuple[protocol.TownSummary, ...]:
        """Return all towns."""
        return self._get(protocol.TownList, "towns").towns

    def town(self, town: str) -> protocol.TownDetail:
        """Return a town with its approaches and geometry."""
        return self._get(protocol.TownDetail, "towns", town)

    def leaderboards(self) -> tuple[protocol.LeaderboardSummary, ...]:
        """Return the suites that have a leaderboard."""
        return self._get(protocol.LeaderboardList, "leaderboards").leaderboards

    def leaderboard(self, suite: str) -> protocol.Leaderboard:
        """Return the ranking on a suite."""
        return self._get(protocol.Leaderboard, "leaderboards", suite)

    def leaderboard_csv(self, suite: str) -> str:
        """Return the ranking on a suite as CSV, a row for each agent.

        Raises:
            ProtocolError: The service is of a version without it.
        """
        reply = self._transport.call("GET", path_of("v1", "leaderboards", suite), media_type=CSV)
        if reply.media_type != CSV:
            raise ProtocolError(
                f"leaderboard: {self._transport.url} has none as CSV; its operator can upgrade the service"
            )
        return reply.content.decode("utf-8")

    def compare(self, suite: str, a: str, b: str) -> protocol.Comparison:
        """Compare the entries of two agents, each named by its id or name, on a suite with an exact test."""
        return self._get(protocol.Comparison, "leaderboards", suite, "compare", a=a, b=b)

    # Owners, agents and their tokens

    def register_owner(self, name: str, *, contact: str | None = None) -> protocol.RegisteredOwner:
        """Register an owner, who answers for agents. Its token is shown only now.

        A client with that token registers agents for the owner, and rotates and revokes their tokens. Everybody sees
        the name beside the agents, but only the operator sees the contact.

        Raises:
            ValueError: The name or the contact is not valid; the message names it.
        """
        registration = _checked(protocol.OwnerRegistration, name=name, contact=contact)
        return self._create(protocol.RegisteredOwner, registration.model_dump(mode="json"), "owners")

    def owners(self) -> tuple[protocol.OwnerDetail, ...]:
        """Return all owners."""
        return tuple(owner for page in self._pages(protocol.OwnerList, "owners") for owner in page.owners)

    def owner(self, owner: str) -> protocol.OwnerDetail:
        """Return an owner by its id."""
        return self._get(protocol.OwnerDetail, "owners", owner)

    def rotate_owner_token(self, owner: str) -> protocol.RegisteredOwner:
        """Replace an owner's token; the old one becomes invalid. This client keeps using the old one."""
        return self._create(protocol.RegisteredOwner, None, "owners", owner, "token")

    def revoke_owner_token(self, owner: str) -> None:
        """Make an owner's token invalid."""
        self._transport.call("DELETE", path_of("v1", "owners", owner, "token"))

    def register(
        self,
        name: str,
        track: protocol.Track | str,
        *,
        description: str | None = None,
        homepage: str | None = None,
        kind: protocol.AgentKind = protocol.AgentKind.SUBMITTED,
        trained_on_faults: bool = False,
        rig: protocol.Rig | None = None,
    ) -> protocol.RegisteredAgent:
        """Register an agent. Its token is shown only now. Other kinds than ``submitted`` need the operator's token.

        With an owner's token the agent is that owner's. Without a token an owner of the agent's name is made. Say with
        ``trained_on_faults`` that it met wrong commands in its training; the leaderboard marks it. A ``rig``
        declares cameras, inputs and answers that differ from the track's.

        Raises:
            ValueError: The name, the track or another argument is not valid; the message names it.
        """
        registration = _checked(
            protocol.AgentRegistration,
            name=name,
            track=track,
            description=description,
            homepage=homepage,
            kind=kind,
            trained_on_faults=trained_on_faults,
            rig=rig_of(rig),
        )
        return self._create(protocol.RegisteredAgent, registration.model_dump(mode="json"), "agents")

    def agents(self, *, everybody: bool = False) -> tuple[protocol.AgentDetail, ...]:
        """Return the agents that have begun an evaluation; with ``everybody`` also those that have only practised."""
        pages = self._pages(protocol.AgentList, "agents", all=everybody or None)
        return tuple(agent for page in pages for agent in page.agents)

    def agent(self, agent: str) -> protocol.AgentDetail:
        """Return an agent by its id."""
        return self._get(protocol.AgentDetail, "agents", agent)

    def rotate_token(self, agent: str) -> protocol.RegisteredAgent:
        """Replace an agent's token; the old one becomes invalid. This client keeps using the old one."""
        return self._create(protocol.RegisteredAgent, None, "agents", agent, "token")

    def revoke_token(self, agent: str) -> None:
        """Make an agent's token invalid."""
        self._transport.call("DELETE", path_of("v1", "agents", agent, "token"))


def _checked(registration: type[M], /, **fields: Any) -> M:
    """Return a registration. The error for a wrong one is one line about its first wrong field."""
    try:
        return registration(**fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if not first["loc"]:  # fields that do not fit together
            raise ValueError(first["msg"].removeprefix("Value error, ")) from error
        field = str(first["loc"][0])
        rule = (
            f"give {', '.join(protocol.Track)}{did_you_mean(first['input'], protocol.Track)}"
            if field == "track"
            else first["msg"]
        )
        raise ValueError(f"{field}: is {reprlib.repr(first['input'])}; {rule}") from error
