"""The client against ``wrongturn serve``."""

import pytest

from wrongturn_client import AuthenticationError, Client, LocalService, NotFoundError
from wrongturn_protocol import Track


def test_the_public_calls(service: LocalService) -> None:
    with Client(service.url) as client:
        assert client.live()
        assert client.ready()
        suites = {suite.id: suite for suite in client.suites()}
        suite = client.suite("smoke@3")
        assert suite.model_dump(exclude={"cells"}) == suites["smoke@3"].model_dump()
        assert len(suite.cells) == suite.trials == 6
        trials = client.trials("smoke@3")
        assert len(trials) == suites["smoke@3"].trials
        towns = {town.name: town for town in client.towns()}
        town = client.town(trials[0].town)
        assert town.sha256 == towns[town.name].sha256
        assert trials[0].approach in {approach.id for approach in town.approaches}
        agent = client.register("public", Track.PRIVILEGED)
        assert client.agent(agent.id) in client.agents(everybody=True)
        assert "smoke@3" in {board.suite for board in client.leaderboards()}
        assert client.leaderboard("smoke@3").suite == "smoke@3"
        with pytest.raises(NotFoundError, match="smoke@3"):
            client.suite("nothing@1")
        with pytest.raises(AuthenticationError):
            client.create_evaluation("smoke@3")
