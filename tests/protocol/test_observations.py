"""Observations are the same on both sides of the wire."""

import json
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_protocol import Track
from wrongturn_protocol.observations import FIELDS, Observation, decode, encode, observation_space, sentence_of

WIRES: dict[str, Callable[[Observation, Track], Any]] = {
    "json": lambda observation, track: json.loads(json.dumps(encode(observation, track), allow_nan=False)),
    "msgpack": lambda observation, track: msgpack.unpackb(msgpack.packb(encode(observation, track, binary=True))),
}


def _sample(track: Track, seed: int) -> Observation:
    space = observation_space(track)
    space.seed(seed)
    sample: Observation = space.sample()
    if "sentence" in sample:
        sample["sentence"] = sentence_of("Turn left at the Straßenecke.")
    return sample


@pytest.mark.parametrize("wire", WIRES)
@given(track=st.sampled_from(Track), seed=st.integers(0, 2**32 - 1))
def test_round_trip_to_the_last_bit(wire: str, track: Track, seed: int) -> None:
    observation = _sample(track, seed)
    back = decode(WIRES[wire](observation, track), track)
    assert list(back) == [field.name for field in FIELDS[track]]
    for key, array in observation.items():
        assert back[key].dtype == array.dtype
        assert back[key].shape == array.shape
        assert back[key].tobytes() == array.tobytes(), key
        assert back[key].flags.writeable
    assert observation_space(track).contains(back)


@pytest.mark.parametrize("track", list(Track))
def test_json_is_as_the_interface_says(track: Track) -> None:
    message = encode(_sample(track, 1), track)
    assert isinstance(message["speed"], float)
    assert isinstance(message.get("command", 0), int)
    assert message.get("sentence", "") in {"", "Turn left at the Straßenecke."}
    for image in {"rgb", "segmentation"} & set(message):
        assert set(message[image]) == {"shape", "dtype", "data"}
        assert message[image]["dtype"] == "uint8"
        assert isinstance(message[image]["data"], str)
    if track is Track.PRIVILEGED:
        assert np.shape(message["exits"]) == (3, 60, 2)
        assert isinstance(message["exits"], list)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("track", list(Track))
def test_what_is_missing_or_misshapen_is_named(wire: str, track: Track) -> None:
    for field in FIELDS[track]:
        message = WIRES[wire](_sample(track, 2), track)
        del message[field.name]
        with pytest.raises(ValueError, match=f"observation.{field.name}: missing"):
            decode(message, track)
        if not field.scalar:
            message[field.name] = [[1, 2], [3, 4]]
            with pytest.raises(ValueError, match=rf"observation.{field.name}: has shape \(2, 2\)"):
                decode(message, track)


def test_nothing_outside_the_privileged_track_tells_of_the_fault() -> None:
    told = {"speed", "steering", "command", "sentence", "rgb", "segmentation"}
    for track in set(Track) - {Track.PRIVILEGED}:
        assert {field.name for field in FIELDS[track]} <= told
