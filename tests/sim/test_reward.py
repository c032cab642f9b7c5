import math

import pytest

from wrongturn_faults.rules import Guidance
from wrongturn_protocol import Command
from wrongturn_sim.reward import reward


def guidance(command, lateral=0.0, heading=0.0):
    return Guidance(command, lateral=lateral, heading=heading)


@pytest.mark.parametrize(
    ("v", "yaw", "where", "expected"),
    [
        (35 / 3.6, 0.0, guidance(Command.LANE_FOLLOW), 35 + 10 + 1.5),
        (15 / 3.6, 0.0, guidance(Command.LEFT), 15 + 10 + 1.5),
        (25 / 3.6, 0.0, guidance(Command.STRAIGHT), 5 + 10 + 1.5),
        (0.0, 0.0, guidance(Command.LANE_FOLLOW), 0 + 10 + 1.5),
        (35 / 3.6, 0.0, guidance(Command.LANE_FOLLOW, lateral=-2.0), 35 - 10 + 1.5),
        (35 / 3.6, math.radians(-25), guidance(Command.LANE_FOLLOW), 35 + 10 - 1.0),
        (35 / 3.6, math.radians(175), guidance(Command.LANE_FOLLOW, heading=math.radians(-175)), 35 + 10 + 0.5),
    ],
)
def test_the_papers_formula(v, yaw, where, expected):
    assert reward(v, yaw, where) == pytest.approx(expected)
