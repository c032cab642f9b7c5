"""The baselines on a hand-made junction, by what they do and not by a verdict."""

import numpy as np
import pytest
from handmade_street import LANE_Y, STOP_X, Street, exit_path

from wrongturn_agents.baselines import AlwaysStops, Careful, IgnoresCommands, ObeysBlindly, Parked
from wrongturn_protocol import DIRECTIONS, Command

LEFT, RIGHT, STRAIGHT, FOLLOW = Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW
STARTS = [(22.0, 9.0, 0.4, 0.1), (30.0, 4.0, -0.4, -0.1), (26.0, 7.0, 0.0, 0.0)]


def street(exits, command, start=STARTS[2]) -> Street:
    distance, speed, lateral, yaw = start
    return Street(exits, command, distance=distance, speed=speed, lateral=lateral, yaw=yaw)


@pytest.mark.parametrize("command", DIRECTIONS)
def test_careful_obeys_where_the_exit_exists(command):
    driven = street(DIRECTIONS, command).drive(Careful(), 9.0)
    assert driven.miss(exit_path(command)) < 0.3


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("agent", [Careful, AlwaysStops])
@pytest.mark.parametrize("command", [STRAIGHT, FOLLOW])
def test_they_stop_engaged_and_before_the_line(agent, command, start):
    driven = street((LEFT, RIGHT), command, start).drive(agent(), 12.0)
    nose = driven.x + 2.3
    assert STOP_X - 1.5 < nose < STOP_X - 0.3
    assert driven.speed == 0.0
    standing = [row for row in driven.trace if row[3] < 0.3]
    assert len(standing) > 60
    assert min(row[0] for row in standing) > STOP_X - 15.0


def test_careful_goes_on_when_a_right_command_comes_late():
    driven = street((LEFT, RIGHT), FOLLOW)
    agent = Careful()
    driven.drive(agent, 6.0)
    assert driven.speed == 0.0
    driven.command = LEFT
    for _ in range(80):
        driven.step(agent.act(driven.observe()))
    assert driven.y > 10.0


def test_careful_does_not_stop_inside_when_the_command_vanishes_too_late():
    driven = street((LEFT, STRAIGHT), STRAIGHT)
    agent = Careful()
    while driven.x < STOP_X - 2.5:
        driven.step(agent.act(driven.observe()))
    driven.command = FOLLOW
    for _ in range(40):
        driven.step(agent.act(driven.observe()))
        assert driven.speed > 3.0
    assert driven.x > 0.0


@pytest.mark.parametrize("command", [LEFT, RIGHT, STRAIGHT, FOLLOW])
def test_ignores_commands_always_takes_the_same_exit(command):
    driven = street((RIGHT, STRAIGHT), command).drive(IgnoresCommands(), 9.0)
    assert driven.miss(exit_path(RIGHT)) < 0.3


@pytest.mark.parametrize(
    ("command", "exits", "went"),
    [
        (LEFT, (RIGHT, STRAIGHT), (0.0, 1.0)),
        (RIGHT, (LEFT, STRAIGHT), (0.0, -1.0)),
        (STRAIGHT, (LEFT, RIGHT), (1.0, 0.0)),
        (FOLLOW, (LEFT, RIGHT), (1.0, 0.0)),
        (FOLLOW, DIRECTIONS, (1.0, 0.0)),
    ],
)
def test_obeys_blindly_goes_where_there_is_nothing(command, exits, went):
    driven = street(exits, command).drive(ObeysBlindly(), 7.0)
    way = np.array((driven.x - STOP_X, driven.y - LANE_Y))
    assert np.dot(way, went) > 15.0


def test_parked_stands_before_it_is_engaged():
    driven = street(DIRECTIONS, LEFT, STARTS[0]).drive(Parked(), 4.0)
    assert driven.speed == 0.0
    assert driven.x < STOP_X - 15.0


def test_an_agent_forgets_its_last_episode():
    agent = Careful()
    fresh = street(DIRECTIONS, RIGHT).drive(Careful(), 6.0)
    street(DIRECTIONS, LEFT, STARTS[0]).drive(agent, 6.0)
    again = street(DIRECTIONS, RIGHT).drive(agent, 6.0)
    assert again.trace == fresh.trace
