"""The baselines' driving where more than one junction lies on the way, and others on the road."""

import numpy as np
import pytest
from handmade_street import LANE_Y, STOP_X, Street

from wrongturn_agents.baselines import Careful
from wrongturn_networks import load_suite
from wrongturn_protocol import Command, Track, Verdict
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_sim import Episode

OTHER_X = STOP_X - 6.0


class Shared(Street):
    """A street with somebody else on it."""

    def __init__(self, side: float, speed: float = 0.0) -> None:
        super().__init__((Command.LEFT, Command.STRAIGHT), Command.STRAIGHT, distance=40.0, speed=7.0)
        self._other = [OTHER_X, LANE_Y + side, 0.0, 4.5, 1.8, speed]

    def observe(self) -> Observation:
        observation = super().observe()
        observation["road_users"][0] = np.array(self._other, np.float32)
        observation["road_users_count"][:] = 1
        return observation

    def step(self, action) -> None:
        self._other[0] += 0.1 * self._other[5]
        super().step(action)


def test_careful_stands_behind_who_stands_in_its_way():
    driven = Shared(0.5).drive(Careful(), 12.0)
    assert driven.speed == 0.0
    assert 1.5 < OTHER_X - 2.25 - (driven.x + 2.3) < 4.0


def test_careful_follows_who_is_slower():
    driven = Shared(0.0, speed=3.0).drive(Careful(), 8.0)
    assert 2.0 < driven.speed < 4.0
    assert driven.x + 2.3 < OTHER_X - 2.25 + 24.0


@pytest.mark.parametrize("side", [3.5, -4.0])
def test_careful_passes_who_is_beside_its_way(side):
    driven = Shared(side).drive(Careful(), 9.0)
    assert driven.x > STOP_X + 10.0
    assert driven.speed > 6.0


@pytest.mark.parametrize(
    "trial",
    [
        "Town02.navigation.J8-S.s13001",  # a short street between two junctions, with the same turn at both
        "Town01.one_turn.J9-N.s4006",
        "Town02.navigation_dynamic.J4-N.s13018",
    ],
)
def test_careful_arrives(trial):
    episode, agent = Episode(load_suite("navigation@1").trial(trial), Track.PRIVILEGED), Careful()
    observation = episode.reset()
    agent.reset(observation_space(Track.PRIVILEGED))
    while episode.outcome is None:
        action = agent.act(observation)
        observation = episode.step(action.steer, action.throttle, action.brake).observation
    assert episode.outcome.verdict is Verdict.ARRIVED
    assert episode.outcome.journey is not None
    assert episode.outcome.journey.clean
