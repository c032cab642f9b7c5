"""What a rig may say, what a model of one may take and give, and what its answers mean."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_protocol import (
    Action,
    AgentRegistration,
    ContractError,
    ModelSignature,
    Rig,
    RigError,
    TensorSpec,
    Track,
)
from wrongturn_protocol import contract_of as contract
from wrongturn_protocol.answers import driver_of
from wrongturn_protocol.episodes import ActionError
from wrongturn_protocol.observations import decode_rig, encode, fields_of, observation_space, sentence_of, text
from wrongturn_protocol.rigs import PIXELS, rig_of, sight_from, sight_of, text_of
from wrongturn_protocol.wire import MalformedMessageError, arrays, block

CAMERA = {"name": "front", "width": 90, "height": 32}
WAYPOINTS = {"kind": "waypoints", "times": [0.5, 1.0]}
RIG = rig_of({"cameras": [CAMERA], "navigation": ["command", "sentence"], "action": WAYPOINTS})
assert RIG is not None

cameras = st.builds(
    lambda number, width, height, kind, history: {
        "name": f"eye{number}", "width": width, "height": height, "kind": kind, "history": history,
    },
    st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 60), st.sampled_from(["rgb", "segmentation"]),
    st.integers(1, 8),
)  # fmt: skip
rigs = st.builds(
    lambda eyes, told, rate: Rig.model_validate({"cameras": eyes, "navigation": told, "rate": rate}),
    st.lists(cameras, max_size=6, unique_by=lambda one: one["name"]),
    st.lists(st.sampled_from(["command", "next_command", "distance", "target_points", "sentence"]), unique=True),
    st.sampled_from([10, 20]),
)


@given(rigs, st.integers(0, 2**32 - 1))
def test_any_rig_and_its_observations_survive_the_wire(rig: Rig, seed: int) -> None:
    assert sight_from(text_of(rig)) == rig
    space = observation_space(rig)
    space.seed(seed)
    seen = dict(space.sample())
    if "sentence" in seen:
        seen["sentence"] = sentence_of("Nach der Brücke links.")
        assert text(seen["sentence"]) == "Nach der Brücke links."
    if "target_points" in seen:
        seen["target_points"] = np.float32([[1.5, 0.25], [1e4, -3.125]])
    for back in (decode_rig(json.loads(json.dumps(encode(seen, rig)))), arrays(block(seen, rig))):
        assert list(back) == [field.name for field in fields_of(rig)]
        assert space.contains(back)
        assert all(back[name].tobytes() == array.tobytes() for name, array in seen.items())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cameras": [CAMERA] * 7}, "rig.cameras"),
        ({"cameras": [CAMERA, CAMERA]}, "cameras.1.name: front is the name of another input"),
        ({"cameras": [{**CAMERA, "name": "speed"}]}, "cameras.0.name: speed is the name of another input"),
        ({"cameras": [{**CAMERA, "name": "Front"}]}, "rig.cameras.0.name"),
        ({"cameras": [{**CAMERA, "width": 2049}]}, "rig.cameras.0.width"),
        ({"cameras": [{**CAMERA, "width": 0}]}, "rig.cameras.0.width"),
        ({"cameras": [{**CAMERA, "fov": float("nan")}]}, "rig.cameras.0.fov"),
        ({"cameras": [{**CAMERA, "fov": 180}]}, "rig.cameras.0.fov"),
        ({"cameras": [{**CAMERA, "rate": 3}]}, "cameras.0.rate: 3 does not divide the rig's rate of 10"),
        ({"cameras": [{**CAMERA, "kind": "segmentation", "jpeg": 80}]}, "rig.cameras.0: jpeg: classes of pixels"),
        ({"cameras": [{**CAMERA, "width": 1024, "height": 512, "history": 2}]}, f"1048576 pixels .* at most {PIXELS}"),
        ({"cameras": [{**CAMERA, "lens": 3}]}, "rig.cameras.0.lens"),
        ({"navigation": ["command", "command"]}, "navigation: names an input twice"),
        ({"navigation": ["gps"]}, "rig.navigation.0"),
        ({"sentences": []}, "sentences: are none"),
        ({"sentences": ["odd"]}, "rig.sentences.0"),
        ({"rate": 15}, "rig.rate"),
        ({"action": {"kind": "waypoints"}}, "rig.action: times: give growing seconds"),
        ({"action": {"kind": "waypoints", "times": [1.0, 1.0]}}, "rig.action: times: give growing seconds"),
        ({"action": {"times": [1.0]}}, "rig.action: times: controls have none"),
        ({"action": {"side": "right"}}, "rig.action: times: controls have none, nor side"),
        ({"action": {**WAYPOINTS, "gains": {"steer": [float("nan"), 0]}}}, "rig.action.gains.steer.0"),
        ({"action": {**WAYPOINTS, "gains": {"lasting_s": 0}}}, "rig.action.gains.lasting_s"),
        ({"cameras": [{**CAMERA, "width": "90"}]}, "rig.cameras.0.width"),
        ({"cameras": [{**CAMERA, "history": True}]}, "rig.cameras.0.history"),
        ({"navigation": ["sentence"], "sentences": ["plain", "plain"]}, "sentences: are none, or one twice"),
        ({"action": {"kind": "waypoints", "times": [1e-300]}}, "rig.action.times.0"),
        (3, "rig: Input should be an object"),
        ("{", "rig: Invalid JSON"),
        ([], "rig"),
    ],
)
def test_a_rig_that_cannot_be_is_refused_with_its_field(wrong: Any, message: str) -> None:
    with pytest.raises(RigError, match=message):
        rig_of(wrong)


@pytest.mark.parametrize(
    ("track", "rig", "message"),
    [
        ("privileged", {}, "the privileged track has none"),
        ("camera", {"cameras": [{**CAMERA, "kind": "segmentation"}]}, "front shows classes"),
        ("camera", {"navigation": ["sentence"]}, "the track words has sentences"),
        ("words", {"navigation": []}, "the track words has sentences"),
        ("words", {"navigation": ["sentence", "target_points"]}, "the sentence alone"),
    ],
)
def test_a_track_allows_its_own_rigs_alone(track: str, rig: dict[str, Any], message: str) -> None:
    with pytest.raises(RigError, match=message):
        sight_of(Track(track), rig_of(rig))
    with pytest.raises(ValueError, match=message):
        AgentRegistration.model_validate({"name": "a", "track": track, "rig": rig})


def signature(rig: Any, outputs: dict[str, tuple[Any, ...]], front: tuple[Any, ...] = (1, 32, 90, 3), **more: str):
    inputs = TensorSpec("front", "uint8", front), TensorSpec("sentence", "uint8", ("N", 160))
    metadata = {"rig": rig if isinstance(rig, str) else rig.text, **more}
    puts = tuple(TensorSpec(name, "float32", shape) for name, shape in outputs.items())
    return ModelSignature(inputs, puts, 18, metadata)


def test_a_model_of_a_rig_takes_its_pictures_and_gives_its_waypoints() -> None:
    words = RIG.model_copy(update={"navigation": RIG.navigation[1:]})
    found = contract(signature(words, {"waypoints": ("N", 2, 2)}))
    assert (found.track, found.sight) == (Track.WORDS, words)
    given = np.float32([[[1, 2], [3, 4]]])
    np.testing.assert_array_equal(found.action({"waypoints": given}), given[0])
    with pytest.raises(ContractError, match=r"waypoints: is .* must be finite and float32 \(1, 2, 2\)"):
        found.action({"waypoints": given * np.nan})
    with pytest.raises(ContractError, match="waypoints: is farther than 1000000 m"):
        found.action({"waypoints": given * np.float32(1e37)})
    changes = words.model_copy(update={"action": words.action.model_copy(update={"kind": "increments", "times": ()})})
    found = contract(signature(changes, {"steer": ("N", 1), "accelerate": ("N", 1)}))
    values = {"steer": np.float32([[-3.0]]), "accelerate": np.float32([[-0.5]])}
    np.testing.assert_array_equal(found.action(values), [-2.0, 0.0, 0.5])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (signature(RIG, {"waypoints": ("N", 2, 2)}, track="camera"), "the track words has sentences"),
        (signature("{}", {"action": ("N", 3)}), "front, sentence: not in the metadata's rig; it has speed, steering"),
        (signature('{"rate": 5}', {"action": ("N", 3)}), "metadata rig.rate"),
        (signature(RIG, {"waypoints": ("N", 2, 2)}), "rig.navigation: the track words has the sentence alone"),
        (
            signature(RIG.model_copy(update={"navigation": RIG.navigation[1:]}), {"action": ("N", 3)}, (1, 90, 32, 3)),
            r"input front: takes \(1, 90, 32, 3\); let it take \(N, 32, 90, 3\).*; outputs: there is no waypoints",
        ),
        (
            signature(RIG.model_copy(update={"navigation": RIG.navigation[1:]}), {"waypoints": ("N", 4, 2)}),
            r"output waypoints: is \(N, 4, 2\); let it be \(N, 2, 2\), one point for each",
        ),
    ],
)
def test_a_model_that_breaks_its_rig_is_named_before_it_drives(given: ModelSignature, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        contract(given)


def test_answers_become_controls_of_one_episode() -> None:
    seen = {"speed": np.float32([5.0]), "steering": np.float32([0.25])}
    turn = driver_of(rig_of({"action": {"kind": "increments"}}))
    assert [turn((0.5, 0.2, 0.0), seen).steer for _ in range(3)] == [0.75, 1.0, 1.0]
    assert turn((-0.25, 0.2, 0.0), seen) == Action(0.75, 0.2, 0.0)
    follow = driver_of(RIG)
    assert follow([[2.5, 0.0], [5.0, 0.0]], seen).steer == 0.0
    assert follow([[2.5, 1.0], [5.0, 4.0]], seen).steer < 0.0, "the left is negative"
    assert follow(Action(1.0, 0.5, 0.0), seen) == Action(1.0, 0.5, 0.0)
    for drive, answer, message in (
        (turn, (3.0, 0.0, 0.0), "its change is 3.0; give -2 to 2"),
        (turn, (0.0, 2.0, 0.0), "throttle"),
        (follow, [[1.0, 2.0]], r"shape \(1, 2\); give \(2, 2\)"),
        (follow, [[1.0, 2.0], [np.inf, 0.0]], "not finite"),
        (follow, [[1.0, 2.0], [1e308, 0.0]], "not finite, or farther"),
        (follow, [[10**400, 0.0]] * 2, "waypoints: are no numbers"),
        (follow, {"waypoints": 1}, "waypoints: are no numbers"),
        (driver_of(Track.CAMERA), [[1.0, 2.0]], "three numbers"),
    ):
        with pytest.raises(ActionError, match=message):
            drive(answer, seen)


def test_a_rigs_block_that_is_none_is_refused() -> None:
    whole = block({**observation_space(Rig()).sample()}, Rig())
    for data in (whole[:-3], whole[:7], whole.replace(b"steering", b"STEERING")):
        with pytest.raises(MalformedMessageError, match="cannot be read"):
            arrays(data)
