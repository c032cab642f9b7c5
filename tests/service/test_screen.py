"""Observations in memory that is written to by turns: who still has one when its place is needed keeps it."""

import os

import numpy as np
import pytest

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_service.pool.screen import Painter, Screen, Shown


@pytest.fixture
def screen() -> Screen:
    return Screen()


def observed(track: Track, seed: int) -> Observation:
    space = observation_space(track)
    space.seed(seed)
    return dict(space.sample())


def painted(screen: Screen, painter: Painter, track: Track, seed: int) -> Shown:
    place = screen.turn()
    return screen.shown(len(painter.paint(observed(track, seed), track, place)))


def painter_of(screen: Screen) -> Painter:
    with screen.lent() as handle:
        return Painter(os.dup(handle))


def test_what_is_kept_stays_as_it_was(screen: Screen) -> None:
    painter = painter_of(screen)
    shown = [painted(screen, painter, Track.SEGMENTATION, seed) for seed in range(6)]
    for seed, one in enumerate(shown):
        assert bytes(one) == wire.block(observed(Track.SEGMENTATION, seed), Track.SEGMENTATION)


def test_the_last_one_is_whole_while_the_next_is_being_written(screen: Screen) -> None:
    painter = painter_of(screen)
    last = painted(screen, painter, Track.CAMERA, 1)
    painter.paint(observed(Track.CAMERA, 2), Track.CAMERA, screen.turn())
    assert last == wire.block(observed(Track.CAMERA, 1), Track.CAMERA)
    assert last != wire.block(observed(Track.CAMERA, 2), Track.CAMERA)


def test_another_track_leaves_nothing_between_its_arrays(screen: Screen) -> None:
    painter = painter_of(screen)
    for seed in range(2):
        painted(screen, painter, Track.SEGMENTATION, seed)
    for seed in range(2):
        block = wire.block(observed(Track.PRIVILEGED, seed), Track.PRIVILEGED)
        assert painted(screen, painter, Track.PRIVILEGED, seed) == block


def test_an_array_of_another_shape_is_named(screen: Screen) -> None:
    observation = observed(Track.STATE, 0) | {"speed": np.zeros(2, np.float32)}
    with pytest.raises(ValueError, match=r"observation\.speed: has shape \(2,\)"):
        painter_of(screen).paint(observation, Track.STATE, 0)
