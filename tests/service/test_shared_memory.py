"""Observations in memory that is written to by turns: who still has one when its place is needed keeps it."""

import os

import numpy as np
import pytest

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_service.simulators.shared_memory import ObservationView, SharedMemory, SharedMemoryWriter


@pytest.fixture
def shared() -> SharedMemory:
    return SharedMemory()


def observed(track: Track, seed: int) -> Observation:
    space = observation_space(track)
    space.seed(seed)
    return dict(space.sample())


def written(shared: SharedMemory, writer: SharedMemoryWriter, track: Track, seed: int) -> ObservationView:
    place = shared.next_place()
    return shared.view(len(writer.write(observed(track, seed), track, place)))


def writer_of(shared: SharedMemory) -> SharedMemoryWriter:
    with shared.inherited() as handle:
        return SharedMemoryWriter(os.dup(handle))


def test_what_is_kept_stays_as_it_was(shared: SharedMemory) -> None:
    writer = writer_of(shared)
    shown = [written(shared, writer, Track.SEGMENTATION, seed) for seed in range(6)]
    for seed, one in enumerate(shown):
        assert bytes(one) == wire.block(observed(Track.SEGMENTATION, seed), Track.SEGMENTATION)


def test_the_last_one_is_whole_while_the_next_is_being_written(shared: SharedMemory) -> None:
    writer = writer_of(shared)
    last = written(shared, writer, Track.CAMERA, 1)
    writer.write(observed(Track.CAMERA, 2), Track.CAMERA, shared.next_place())
    assert last == wire.block(observed(Track.CAMERA, 1), Track.CAMERA)
    assert last != wire.block(observed(Track.CAMERA, 2), Track.CAMERA)


def test_another_track_leaves_nothing_between_its_arrays(shared: SharedMemory) -> None:
    writer = writer_of(shared)
    for seed in range(2):
        written(shared, writer, Track.SEGMENTATION, seed)
    for seed in range(2):
        block = wire.block(observed(Track.PRIVILEGED, seed), Track.PRIVILEGED)
        assert written(shared, writer, Track.PRIVILEGED, seed) == block


def test_an_array_of_another_shape_is_named(shared: SharedMemory) -> None:
    observation = observed(Track.STATE, 0) | {"speed": np.zeros(2, np.float32)}
    with pytest.raises(ValueError, match=r"observation\.speed: has shape \(2,\)"):
        writer_of(shared).write(observation, Track.STATE, 0)
