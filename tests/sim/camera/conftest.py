"""What the camera's tests share."""

import math

import numpy as np
import pytest

from wrongturn_networks import Approach, Town, load_town
from wrongturn_sim.camera import World


@pytest.fixture(scope="session")
def town() -> Town:
    return load_town("junctions")


@pytest.fixture(scope="session")
def world(town: Town) -> World:
    return World.of(town)


def _before(approach: Approach, distance: float) -> tuple[float, float, float]:
    """The pose so many metres before a stop line."""
    x, y = approach.stop_line
    return x - distance * math.cos(approach.heading), y - distance * math.sin(approach.heading), approach.heading


@pytest.fixture(scope="session")
def before():
    return _before


@pytest.fixture(scope="session")
def bare(world: World) -> World:
    """The ground alone."""
    return World(world.name, world.sha256, world.ground, world.frame, np.zeros((0, world.scenery.shape[1])))
