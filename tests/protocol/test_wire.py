import re
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import FIELDS, observation_space


def _sample(track: Track) -> dict[str, np.ndarray]:
    space = observation_space(track)
    space.seed(5)
    return dict(space.sample())


@pytest.mark.parametrize("track", Track)
def test_an_observation_survives_as_a_block(track: Track) -> None:
    observation = _sample(track)

    back = wire.arrays(wire.block(observation, track))

    assert list(back) == [field.name for field in FIELDS[track]]
    for field in FIELDS[track]:
        assert back[field.name].dtype == field.numpy_dtype
        np.testing.assert_array_equal(back[field.name], observation[field.name])


@pytest.mark.parametrize("track", Track)
def test_arrays_of_a_block_are_aligned_and_ones_own(track: Track) -> None:
    data = wire.block(_sample(track), track)
    first, second = wire.arrays(data), wire.arrays(data)

    for array in first.values():
        assert array.flags.aligned
        array[...] = 0
    assert data == wire.block(second, track)


def test_a_block_of_no_tracks_length_is_refused() -> None:
    with pytest.raises(wire.MalformedMessageError, match="5 bytes"):
        wire.arrays(b"12345")


def test_a_block_refuses_another_shape_by_the_keys_name() -> None:
    observation = _sample(Track.CAMERA)
    observation["rgb"] = observation["rgb"][:10]
    with pytest.raises(ValueError, match=r"observation\.rgb"):
        wire.block(observation, Track.CAMERA)


RESULTS = st.tuples(
    st.integers(0, 999),
    st.dictionaries(st.text(max_size=4), st.none() | st.integers(0, 9) | st.binary(max_size=30), max_size=3),
    st.sampled_from([wire.layout(track).size for track in Track] + [0, 255, 256]).map(bytes) | st.none(),
)


@given(st.none() | st.integers(0, 2**32 - 1), st.lists(RESULTS, max_size=3))
def test_a_reply_is_read_as_msgpack_reads_it(number: int | None, results: list[tuple[Any, ...]]) -> None:
    packed = wire.join_results(number, [wire.pack_result(*result) for result in results])
    assert wire.unpack_results(packed) == tuple(msgpack.unpackb(packed))
    assert wire.unpack_results(memoryview(packed)) == tuple(msgpack.unpackb(packed))


MESSAGE = wire.pack_calls(7, [["step", "ep_1", 1, 0.25, 1.0, 0.0], ["look", "ep_2"]])


@pytest.mark.parametrize("length", range(len(MESSAGE)))
def test_a_message_cut_short_is_called_truncated(length: int) -> None:
    with pytest.raises(wire.TruncatedMessageError, match=f"after {length} bytes"):
        wire.unpack_calls(MESSAGE[:length])


@pytest.mark.parametrize(
    "message",
    [
        b"\xc1",
        MESSAGE + b"\x00",
        msgpack.packb("text"),
        msgpack.packb([1]),
        msgpack.packb([1, 2]),
        msgpack.packb([-1, [["look", "e"]]]),
        msgpack.packb([2**32, [["look", "e"]]]),
        msgpack.packb([True, [["look", "e"]]]),
        msgpack.packb([1, []]),
        msgpack.packb([1, [["look", "e"]] * (wire.CALLS + 1)]),
        b"\x91" * 5000 + b"\x00",
        b"\xa1\xff",
        b"\x92\x01\x80",
        b"\x93\x01\x91\xc0\xc0",
        b"\x92\x01\x91\x92\xa8practise\x81\x90\x01",
        b"\x92\x01\x91" + b"\x91" * 5000 + b"\xc0",
    ],
)
def test_what_is_no_message_is_refused(message: bytes) -> None:
    with pytest.raises(wire.MalformedMessageError) as caught:
        wire.unpack_calls(message)
    assert not isinstance(caught.value, wire.TruncatedMessageError)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    for unpack in (wire.unpack_calls, wire.unpack_results):
        try:
            unpack(data)
        except wire.MalformedMessageError:
            continue


PAGE = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")


def _bytes_of_page(kind: str) -> bytes:
    found = re.search(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return bytes.fromhex(found.group(1))


def test_the_pages_example_is_what_is_sent() -> None:
    calls = [["step", "ep_7Qk2", 1, 0.25, 0.5, 0.0], ["step", "ep_none", 1, 0.0, 0.0, 1.0]]
    assert wire.pack_calls(7, calls) == _bytes_of_page("call")
    assert wire.unpack_calls(_bytes_of_page("call")) == (7, calls)


def test_the_pages_example_is_what_is_answered() -> None:
    number, (stepped, refused) = wire.unpack_results(_bytes_of_page("reply"))
    assert number == 7
    assert stepped[:2] == [200, {"seq": 1, "terminated": False, "truncated": False}]
    observation = wire.arrays(stepped[2])
    assert {name: array.item() for name, array in observation.items()} == {
        "speed": 6.5,
        "steering": -0.25,
        "command": 4,
    }
    assert stepped[2] == wire.block(observation, Track.STATE)
    packed = [wire.pack_result(*stepped), wire.pack_result(*refused)]
    assert wire.join_results(7, packed) == _bytes_of_page("reply")


def test_the_page_tells_where_each_array_lies_and_names_each_call() -> None:
    for call in wire.Call:
        assert f'| `["{call.value}", ' in PAGE
    for track in Track:
        told = wire.layout(track)
        arrays = ", ".join(f"{part.offset} `{part.name}`" for part in told.parts)
        assert f"| `{track.value}` | {told.size:,} | {arrays} |" in PAGE
