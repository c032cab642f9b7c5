"""Fixtures of the camera's tests."""

import numpy as np
import pytest

from wrongturn_networks import Town, load_town
from wrongturn_sim.camera import World
from wrongturn_sim.camera.palette import pose_before


@pytest.fixture(scope="session")
def town() -> Town:
    return load_town("junctions")


@pytest.fixture(scope="session")
def world(town: Town) -> World:
    return World.of(town)


@pytest.fixture(scope="session")
def before():
    """Function of an approach and a distance: the pose this many metres before the stop line."""
    return pose_before


@pytest.fixture(scope="session")
def bare(world: World) -> World:
    """A world of ground and sky alone."""
    return World(world.ground, world.frame, np.zeros((0, world.scenery.shape[1])))
