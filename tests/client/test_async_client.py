"""The asyncio client says what the other one says."""

import asyncio
import inspect

import numpy as np
import pytest
from client_fake_service import FakeService

from wrongturn_client import Action, AsyncClient, Client, LocalService, NotFoundError
from wrongturn_client.async_client import AsyncDrive
from wrongturn_client.drive import DriveSocket
from wrongturn_protocol import PracticeRequest, Track

GAS = Action(steer=0.0, throttle=0.8, brake=0.0)


@pytest.mark.parametrize(("blocking", "awaited"), [(Client, AsyncClient), (DriveSocket, AsyncDrive)])
def test_it_has_the_same_calls(blocking: type, awaited: type) -> None:
    own = {"connection", "exchange"}  # of the blocking loops alone
    calls = {name for name, _ in inspect.getmembers(blocking, callable) if not name.startswith("_")} - own
    assert len(calls) >= 7
    for name in calls:
        there = getattr(awaited, name)
        assert inspect.iscoroutinefunction(there)
        if name != "drive":
            assert inspect.signature(there) == inspect.signature(getattr(blocking, name))


class Unhurried:
    def reset(self, observation_space: object) -> None:
        pass

    def act(self, observation: object) -> Action:
        return GAS


async def test_calls_are_answered_while_others_wait() -> None:
    fake = FakeService(parallel=2)
    async with AsyncClient("http://fake", "t", transport=fake.transport) as client:
        evaluation, suites = await asyncio.gather(client.evaluate(Unhurried(), "smoke@3"), client.suites())
    assert evaluation.finished == evaluation.trials
    assert [suite.id for suite in suites] == ["smoke@3"]


async def test_it_drives_over_the_socket(service: LocalService) -> None:
    async with AsyncClient(service.url) as anybody:
        agent = await anybody.register(f"async {np.random.default_rng().integers(2**40)}", Track.PRIVILEGED)
    async with AsyncClient(service.url, agent.token) as client, await client.drive() as drive:
        begun = [await drive.practise(PracticeRequest(town="Town01", approach="J3-S", seed=seed)) for seed in (1, 2)]
        for seq in (1, 2):
            replies = await drive.steps([(episode.id, seq, GAS) for episode in begun])
            assert [reply.seq for reply in replies if not isinstance(reply, Exception)] == [seq, seq]
        assert (await drive.episode(begun[0].id)).seq == 2
        for episode in begun:
            await drive.abort_episode(episode.id)
        with pytest.raises(NotFoundError):
            await drive.step("ep_none", 1, GAS)
