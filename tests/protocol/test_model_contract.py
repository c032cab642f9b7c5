"""What a model may take and give, and how each breach is reported."""

from collections.abc import Mapping

import numpy as np
import pytest

from wrongturn_protocol import ContractError, ModelSignature, TensorSpec, Track, contract_of
from wrongturn_protocol.model_contract import OPSETS, Shape
from wrongturn_protocol.observations import FIELDS, observation_space

SPEED = TensorSpec("speed", "float32", ("N", 1))
RGB = TensorSpec("rgb", "uint8", ("N", 64, 192, 3))
SEGMENTATION = TensorSpec("segmentation", "uint8", ("N", 64, 192))
STATE_IN = TensorSpec("state_in", "float32", (1, 8))
STATE_OUT = TensorSpec("state_out", "float32", (1, 8))


def control(name: str, shape: Shape = ("N", 1), dtype: str = "float32") -> TensorSpec:
    return TensorSpec(name, dtype, shape)


STEER, ACCELERATE = control("steer"), control("accelerate")


def signature(
    inputs: tuple[TensorSpec, ...] = (SPEED, RGB),
    outputs: tuple[TensorSpec, ...] = (STEER, ACCELERATE),
    *,
    opset: int = 18,
    metadata: Mapping[str, str] | None = None,
) -> ModelSignature:
    return ModelSignature(inputs, outputs, opset, metadata or {})


def values(**outputs: float) -> dict[str, np.ndarray]:
    return {name: np.array([[value]], np.float32) for name, value in outputs.items()}


@pytest.mark.parametrize("track", list(Track))
@pytest.mark.parametrize("batch", [1, "N", None])
def test_a_model_that_takes_every_key_of_a_track(track: Track, batch: int | str | None):
    inputs = tuple(TensorSpec(field.name, field.dtype_name, (batch, *field.shape)) for field in FIELDS[track])
    contract = contract_of(signature(inputs))
    assert contract.track is track
    space = observation_space(track)
    feed = contract.feed(space.sample())
    assert {name: (array.shape, array.dtype) for name, array in feed.items()} == {
        name: ((1, *box.shape), box.dtype) for name, box in space.spaces.items()
    }


def test_the_track_is_the_smallest_unless_the_metadata_names_a_larger_one():
    assert contract_of(signature((SPEED,))).track is Track.STATE
    assert contract_of(signature((SPEED, RGB))).track is Track.CAMERA
    assert contract_of(signature((SPEED,), metadata={"track": "segmentation"})).track is Track.SEGMENTATION
    assert contract_of(signature(), {Track.CAMERA}).track is Track.CAMERA


@pytest.mark.parametrize(
    ("outputs", "given", "action"),
    [
        (("steer", "accelerate"), {"steer": -0.5, "accelerate": 0.25}, (-0.5, 0.25, 0.0)),
        (("steer", "accelerate"), {"steer": -1.5, "accelerate": -3.0}, (-1.0, 0.0, 1.0)),
        (("steer", "throttle", "brake"), {"steer": 2.0, "throttle": -1.0, "brake": 0.75}, (1.0, 0.0, 0.75)),
    ],
)
def test_controls_become_an_action(outputs, given, action):
    contract = contract_of(signature(outputs=tuple(control(name) for name in outputs)))
    made = contract.action(values(**given, value=float("nan")))
    assert (made.steer, made.throttle, made.brake) == action
    flat = contract_of(signature(outputs=tuple(control(name, ("N",)) for name in outputs)))
    assert flat.action({name: array[0] for name, array in values(**given).items()}) == made


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
def test_one_output_called_action(dtype):
    contract = contract_of(signature(outputs=(control("action", ("N", 3), dtype), control("value"))))
    assert contract.outputs == ("action",)
    made = contract.action({"action": np.array([[-2.0, 0.5, 7.0]], dtype)})
    assert (made.steer, made.throttle, made.brake) == (-1.0, 0.5, 1.0)


def test_a_state_begins_with_zeros_and_is_handed_on():
    contract = contract_of(signature((SPEED, STATE_IN), (STEER, ACCELERATE, STATE_OUT)))
    assert contract.inputs == ("speed",)
    assert contract.outputs == ("steer", "accelerate", "state_out")
    assert contract.state_shape == (1, 8)
    observation = {"speed": np.array([3.0], np.float32)}
    first = contract.feed(observation)
    np.testing.assert_array_equal(first["state_in"], np.zeros((1, 8), np.float32))
    remembered = np.arange(8, dtype=np.float32)[None]
    assert contract.state({"state_out": remembered}) is remembered
    assert contract.feed(observation, remembered)["state_in"] is remembered


def test_a_model_without_a_memory():
    contract = contract_of(signature())
    assert contract.state_shape is None
    assert contract.state(values(steer=0.0)) is None
    assert set(contract.feed(observation_space(Track.CAMERA).sample())) == {"speed", "rgb"}


def test_a_doubt_is_a_probability_beside_the_action():
    contract = contract_of(signature(outputs=(STEER, ACCELERATE, control("doubt"))))
    assert (contract.outputs, contract.doubt(values(doubt=1.5))) == (("steer", "accelerate"), 1.0)
    assert contract_of(signature()).doubt({}) is None


def test_opsets_at_the_ends_of_the_range_and_undeclared_shapes_are_accepted():
    for opset in OPSETS:
        assert contract_of(signature(opset=opset)).track is Track.CAMERA
    outputs = (control("steer", ()), control("accelerate", (None, None)))
    assert contract_of(signature((TensorSpec("speed", "float32", ()),), outputs)).track is Track.STATE


def refusal(given: ModelSignature, *more: object) -> str:
    with pytest.raises(ContractError) as caught:
        contract_of(given, *more)
    return str(caught.value)


KEYS = (
    "speed, steering, command; also camera: rgb; words: sentence, rgb; segmentation: rgb, segmentation; "
    "privileged: pose, lane, stop_line, exits, exits_mask, road_users, road_users_count"
)
BREACHES = [
    *(
        (signature(opset=opset), f"opset: {opset}; export the model with one from {OPSETS[0]} to {OPSETS[1]}")
        for opset in (OPSETS[0] - 1, OPSETS[1] + 1)
    ),
    (signature((SPEED, control("velocity"))), f"inputs: velocity: no such observation key; the keys are {KEYS}"),
    (
        signature((RGB, TensorSpec("pose", "float64", (1, 3)))),
        f"inputs: no track has all of these; take the keys of one track: {KEYS}",
    ),
    (
        signature(metadata={"track": "privileged"}),
        "inputs: the metadata's track privileged does not have rgb; remove track from the metadata, or let it be "
        "camera or words or segmentation",
    ),
    (signature(metadata={"trained_on_faults": "maybe"}), "metadata trained_on_faults: maybe; write true or false"),
    (signature(metadata={"trained_on_faults": ""}), "metadata trained_on_faults: empty; write true or false"),
    (
        signature(metadata={"track": "sonar"}),
        "metadata track: sonar is none of state, camera, words, segmentation, privileged",
    ),
    (
        signature((TensorSpec("rgb", "float32", (1, 64, 192, 3)),)),
        "input rgb: takes float32; let it take uint8, and convert it to float32 in the graph",
    ),
    (
        signature((TensorSpec("command", "int32", (1, 1)),)),
        "input command: takes int32; let it take int64, as observations have it",
    ),
    (
        signature((TensorSpec("rgb", "uint8", (1, 3, 64, 192)),)),
        "input rgb: takes (1, 3, 64, 192); let it take (N, 64, 192, 3), where N is a batch axis of 1 or free, "
        "and transpose it in the graph",
    ),
    (
        signature((TensorSpec("speed", "float32", (1,)),)),
        "input speed: takes (1,); let it take (N, 1), where N is a batch axis of 1 or free",
    ),
    (
        signature(outputs=()),
        "outputs: none; the contract wants steer and accelerate; or steer, throttle and brake; or action",
    ),
    (
        signature(outputs=(control("control"),)),
        "outputs: control; the contract wants steer and accelerate; or steer, throttle and brake; or action",
    ),
    (
        signature(outputs=(STEER, ACCELERATE, control("action", ("N", 3)))),
        "outputs: steer, accelerate, action; the contract wants steer and accelerate; or steer, throttle and brake; "
        "or action",
    ),
    (signature(outputs=(control("steer", dtype="int64"), ACCELERATE)), "output steer: is int64; let it be float32"),
    (
        signature(outputs=(control("steer", (), "seq(tensor(float))"), ACCELERATE)),
        "output steer: is seq(tensor(float)); let it be float32",
    ),
    (
        signature(outputs=(STEER, control("accelerate", ("batch", 2)))),
        "output accelerate: is (batch, 2); let it be (N, 1), where N is the batch axis",
    ),
    (
        signature(outputs=(control("action", (1, 2)),)),
        "output action: is (1, 2); let it be (N, 3), where N is the batch axis",
    ),
    (
        signature(outputs=(STEER, ACCELERATE, control("doubt", (1, 3)))),
        "output doubt: is (1, 3); let it be (N, 1), where N is the batch axis",
    ),
    (signature((SPEED, STATE_IN)), "state_in: there is no output state_out; a model with a memory has both"),
    (
        signature(outputs=(STEER, ACCELERATE, STATE_OUT)),
        "state_out: there is no input state_in; a model with a memory has both",
    ),
    (
        signature((TensorSpec("state_in", "float64", (1, 8)),), (STEER, ACCELERATE, STATE_OUT)),
        "input state_in: is float64; let it be float32",
    ),
    (
        signature(
            (TensorSpec("state_in", "float32", (2, 1, 8)),), (STEER, ACCELERATE, control("state_out", (1, 1, 8)))
        ),
        "input state_in: is (2, 1, 8); let it begin with a batch axis of 1, or a free one",
    ),
    (
        signature((TensorSpec("state_in", "float32", (1, 8)),), (STEER, ACCELERATE, control("state_out", (1, "M")))),
        "output state_out: is (1, M); give every axis after the batch axis a fixed size; "
        "state_out: is (1, M) and state_in is (1, 8); give both the same shape",
    ),
    (
        signature(
            (TensorSpec("state_in", "float32", (1, 2, 131_073)),),
            (STEER, ACCELERATE, control("state_out", (1, 2, 131_073))),
        ),
        "input state_in: takes 1048584 bytes; a state has at most 1048576, so remember less",
    ),
    (
        signature((STATE_IN,), (STEER, ACCELERATE, control("state_out", (1, 9)))),
        "state_out: is (1, 9) and state_in is (1, 8); give both the same shape",
    ),
]


@pytest.mark.parametrize(("broken", "says"), BREACHES, ids=[says for _, says in BREACHES])
def test_each_breach_is_named_with_its_remedy(broken: ModelSignature, says: str):
    assert refusal(broken) == says


def test_a_suite_without_the_models_track():
    assert refusal(signature((SPEED,)), (Track.PRIVILEGED, Track.CAMERA)) == (
        "inputs: the suite does not take the model's track, state; set the metadata's track to camera or privileged"
    )
    assert refusal(signature((SEGMENTATION,)), (Track.PRIVILEGED, Track.CAMERA)) == (
        "inputs: the suite does not take the model's track, segmentation; take the keys of one of its tracks "
        "(camera, privileged)"
    )


def test_an_agent_of_another_track():
    suite = (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)
    assert contract_of(signature(), suite, Track.CAMERA).track is Track.CAMERA
    for inputs, says in (
        ((SPEED, RGB, SEGMENTATION), "wants segmentation; do without"),
        ((SPEED,), "is of the state track; set the metadata's track to camera"),
    ):
        assert refusal(signature(inputs), suite, Track.CAMERA) == (
            f"inputs: the agent is of the camera track, and the model {says}, or hand it in with the owner's token by "
            "another name"
        )


def test_whether_it_was_trained_on_faults():
    assert not contract_of(signature()).trained_on_faults
    for word, means in (("true", True), ("True", True), ("TRUE", True), ("False", False)):
        assert contract_of(signature(metadata={"trained_on_faults": word})).trained_on_faults is means


def test_every_breach_is_reported():
    with pytest.raises(ContractError) as caught:
        contract_of(signature((control("velocity"), STATE_IN), (STEER,), opset=1))
    assert [message.partition(":")[0] for message in caught.value.messages] == [
        "opset",
        "inputs",
        "outputs",
        "state_in",
    ]


def test_types_and_shapes_are_reported_beside_a_wrong_track():
    inputs = (TensorSpec("speed", "float64", (1, 1)), TensorSpec("steering", "float32", (1, 2)))
    for more, tracks in (((), (Track.CAMERA,)), ((control("velocity"),), None)):
        with pytest.raises(ContractError) as caught:
            contract_of(signature((*inputs, *more)), tracks)
        assert [message.partition(":")[0] for message in caught.value.messages] == [
            "inputs",
            "input speed",
            "input steering",
        ]


def test_names_that_are_meant_to_harm_stay_short():
    inputs = tuple(TensorSpec(f"\x1b[31m{'x' * 10_000}{number}", "float32", (1,)) for number in range(1000))
    said = refusal(signature(inputs, metadata={"track": "privileged"}))
    assert len(said) < 1000
    assert said.isprintable()


@pytest.mark.parametrize(
    ("outputs", "says"),
    [
        ({"steer": np.zeros((1, 1), np.float32)}, "output accelerate: is missing; the model must give it at each step"),
        (
            values(steer=float("nan"), accelerate=0.0),
            "output steer: is [[nan]], float32 (1, 1); it must be finite and float32 (1, 1)",
        ),
        (
            values(steer=0.0, accelerate=float("inf")),
            "output accelerate: is [[inf]], float32 (1, 1); it must be finite and float32 (1, 1)",
        ),
        (
            {"steer": np.zeros((1, 99), np.float32)},
            "output steer: is float32 (1, 99); it must be finite and float32 (1, 1)",
        ),
        (
            {"steer": np.zeros((1, 1), np.int64)},
            "output steer: is [[0]], int64 (1, 1); it must be finite and float32 (1, 1)",
        ),
    ],
)
def test_outputs_that_are_no_action(outputs, says):
    with pytest.raises(ContractError) as caught:
        contract_of(signature()).action(outputs)
    assert str(caught.value) == says


NOT_FINITE = np.array([[0, 0, 0, np.nan, 0, np.inf, 0, 0]], np.float32)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "is missing; the model must give it at each step"),
        ({"state_out": np.zeros((1, 9), np.float32)}, "is float32 (1, 9); it must be float32 (1, 8), as state_in is"),
        ({"state_out": np.zeros((1, 8))}, "is float64 (1, 8); it must be float32 (1, 8), as state_in is"),
        ({"state_out": NOT_FINITE}, "2 of its 8 numbers are not finite; it must be finite"),
    ],
)
def test_a_state_that_cannot_be_handed_on(given: dict[str, np.ndarray], says: str):
    contract = contract_of(signature((SPEED, STATE_IN), (STEER, ACCELERATE, STATE_OUT)))
    with pytest.raises(ContractError) as caught:
        contract.state(given)
    assert str(caught.value) == f"output state_out: {says}"
