"""What two requests must not do to each other; their store answers when the test says so."""

import asyncio
from typing import Any

import pytest

from wrongturn_service.accounts import Accounts
from wrongturn_service.errors import UnauthenticatedError
from wrongturn_service.idempotency import Idempotency
from wrongturn_service.settings import Settings
from wrongturn_service.storage.models import AgentRow


class EmptyStore:
    """Nothing was stored yet."""

    async def reply(self, _scope: str, _key: str) -> None:
        await asyncio.sleep(0)


class SlowStore:
    """One agent, whose token is looked up as slowly as the test wants."""

    def __init__(self) -> None:
        self.row: AgentRow | None = AgentRow(id="ag_1", track="privileged")
        self.answer = asyncio.Event()

    async def agent_by_token(self, _token: str) -> AgentRow | None:
        found = self.row
        await self.answer.wait()
        return found

    async def set_token(self, *_: Any) -> None:
        self.row = None


async def test_one_request_of_a_key_at_a_time_though_the_one_before_failed() -> None:
    idempotency: Any = Idempotency(EmptyStore())  # type: ignore[arg-type]
    inside, most = 0, 0
    later: list[asyncio.Task[None]] = []

    async def request(*, fails: bool = False) -> None:
        nonlocal inside, most
        try:
            async with idempotency.once("key", "agent", "POST /v1/evaluations", b""):
                inside += 1
                most = max(most, inside)
                await asyncio.sleep(0.01)
                inside -= 1
                if fails:
                    raise ValueError
        except ValueError:
            # The second has been let in but does not run yet; a third must wait for it.
            later.append(asyncio.create_task(request()))

    await asyncio.gather(request(fails=True), request())
    await asyncio.gather(*later)
    assert most == 1
    assert not idempotency._locks


class NoSubmissions:
    """No runner has any token."""

    async def by_token(self, _: str) -> None:
        return None


async def test_a_token_that_is_revoked_while_it_is_looked_up_is_not_remembered() -> None:
    store = SlowStore()
    accounts = Accounts(store, NoSubmissions(), Settings())  # type: ignore[arg-type]
    asked = asyncio.create_task(accounts.caller("Bearer token"))
    await asyncio.sleep(0)
    await accounts.set_token(AgentRow(id="ag_1"), None)
    store.answer.set()
    assert (await asked).id == "ag_1"  # it came before
    with pytest.raises(UnauthenticatedError):
        await accounts.caller("Bearer token")
