"""Honest models load, and their outputs are those of onnxruntime in this process."""

import threading
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper
from upload_models import TAIL, control, ints, model, node, number, proto

import wrongturn_agents
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_protocol import Track
from wrongturn_protocol.observations import FIELDS
from wrongturn_sandbox import Limits, SandboxLostError, TensorInfo, open_sandbox, probe
from wrongturn_sandbox.checking import check

LIMITS = Limits(memory=1 << 30, load_s=60, step_s=60)
FOLDER = Path(wrongturn_agents.__file__).parent / "weights"
WEIGHTS = sorted(
    file for file in FOLDER.glob("*.onnx") if not file.name.endswith((".gate.onnx", ".sentence.onnx"))
)  # no agents by themselves


def in_this_process(content: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def observations(names: list[str], seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    found = {}
    for field in {field.name: field for track in Track for field in FIELDS[track]}.values():
        if field.name in names:
            found[field.name] = random.integers(1, 5, (1, *field.shape)).astype(field.dtype)
    return found


@pytest.mark.usefixtures("bubblewrap")
@pytest.mark.parametrize("file", WEIGHTS, ids=lambda file: file.stem)
def test_shipped_agents_act_the_same(file: Path) -> None:
    content = file.read_bytes()
    own = in_this_process(content)
    with open_sandbox(None, LIMITS) as sandbox:
        description = sandbox.load(content)
        assert [put.name for put in description.inputs] == [put.name for put in own.get_inputs()]
        state = {put.name: put.shape for put in own.get_inputs() if put.name == "state_in"}
        memory = tuple(TensorInfo("state_out", "float32", tuple(shape)) for shape in state.values())
        assert description.outputs == (TensorInfo("action", "float32", ("batch", 3)), *memory)
        assert description.metadata["name"] == file.stem
        assert description.opset == 18
        assert description.parameters > 1_000_000
        for seed in range(5):
            inputs = observations([put.name for put in description.inputs], seed)
            inputs |= {name: np.zeros((1, *shape[1:]), np.float32) for name, shape in state.items()}
            outputs, expected = sandbox.run(inputs), own.run(None, inputs)
            assert list(outputs) == [put.name for put in own.get_outputs()]
            for found, wanted in zip(outputs.values(), expected, strict=True):
                np.testing.assert_array_equal(found, wanted, strict=True)


def test_all_shipped_agents_are_there() -> None:
    assert {file.stem for file in WEIGHTS} == set(SHIPPED_AGENTS)


def test_a_sandbox_says_what_it_is(bubblewrap: None, listener: Path) -> None:
    assert probe(None).startswith("bubblewrap 0.")
    assert probe(listener).startswith("runner container")
    assert f"onnxruntime {onnxruntime.__version__}" in probe(None)


def test_types_go_in_and_out(listener: Path) -> None:
    dtypes = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]
    puts = [
        [
            helper.make_tensor_value_info(f"{name}_{dtype}", helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), [1, "n"])
            for dtype in dtypes
        ]
        for name in ("in", "out")
    ]
    nodes = [node("Identity", [f"in_{dtype}"], [f"out_{dtype}"]) for dtype in dtypes]
    with open_sandbox(listener, LIMITS) as sandbox:
        description = sandbox.load(model(nodes, inputs=puts[0], outputs=puts[1]))
        assert description.inputs == tuple(TensorInfo(f"in_{dtype}", dtype, (1, "n")) for dtype in dtypes)
        given = {dtype: np.array([[0, 1, 1, 0, 1]], dtype) for dtype in dtypes}
        found = sandbox.run({f"in_{dtype}": array for dtype, array in given.items()})
        for dtype, array in given.items():
            np.testing.assert_array_equal(found[f"out_{dtype}"], array, strict=True)


def test_a_model_keeps_its_state_outside(place: Path | None) -> None:
    puts = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 4]) for name in ("state_in", "state_out")]
    speed = helper.make_tensor_value_info("speed", TensorProto.FLOAT, [1, 1])
    nodes = [*TAIL, node("Add", ["state_in", "one"], ["state_out"])]
    content = model(
        nodes, [number("one", 1)], inputs=[speed, puts[0]], outputs=[control("steer"), control("accelerate"), puts[1]]
    )
    state = np.zeros((1, 4), np.float32)
    with open_sandbox(place, LIMITS) as sandbox:
        sandbox.load(content)
        for _ in range(3):
            state = sandbox.run({"speed": np.zeros((1, 1), np.float32), "state_in": state})["state_out"]
    assert state.tolist() == [[3, 3, 3, 3]]


def test_several_sandboxes_do_not_mix(listener: Path) -> None:
    found: dict[int, list[float]] = {}

    def drive(which: int) -> None:
        nodes = [node("Add", ["speed", "own"], ["steer"]), TAIL[1]]
        with open_sandbox(listener, LIMITS) as sandbox:
            sandbox.load(model(nodes, [number("own", which)]))
            given = [np.full((1, 1), step, np.float32) for step in range(50)]
            found[which] = [float(sandbox.run({"speed": speed})["steer"][0, 0]) for speed in given]

    threads = [threading.Thread(target=drive, args=(which,)) for which in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {which: [float(which + step) for step in range(50)] for which in range(4)}


@pytest.mark.parametrize("opset", [7, 26])
def test_the_oldest_and_the_newest_opset(listener: Path, opset: int) -> None:
    with open_sandbox(listener, LIMITS) as sandbox:
        assert sandbox.load(model(opset=opset, ir=3 if opset == 7 else 13)).opset == opset
        assert sandbox.run({"speed": np.zeros((1, 1), np.float32)})["steer"].tolist() == [[0]]


def test_unused_sets_of_operators_may_be_named() -> None:
    made = proto()
    made.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    made.opset_import.append(helper.make_opsetid("ai.onnx.ml", 3))
    assert len(check(made.SerializeToString()).graph.node) == 2


def test_an_input_that_is_no_number_is_the_callers_mistake(listener: Path) -> None:
    with open_sandbox(listener, LIMITS) as sandbox:
        sandbox.load(model())
        with pytest.raises(ValueError, match="speed"):
            sandbox.run({"speed": np.array([["fast"]])})
        assert sandbox.run({"speed": np.zeros((1, 1), np.float32)})  # it still works


def test_a_closed_sandbox_says_so(place: Path | None) -> None:
    sandbox = open_sandbox(place, LIMITS)
    sandbox.close()
    sandbox.close()
    with pytest.raises(SandboxLostError, match="closed"):
        sandbox.load(model())


def test_a_model_of_a_hundred_megabytes_fits(listener: Path) -> None:
    weights = np.full((5000, 5000), 1e-9, np.float32)
    nodes = [
        node("Expand", ["speed", "shape"], ["wide"]),
        node("MatMul", ["wide", "weights"], ["seen"]),
        node("ReduceMax", ["seen"], ["steer"], axes=[1]),
        TAIL[1],
    ]
    constants = [ints("shape", 1, 5000), numpy_helper.from_array(weights, "weights")]
    with open_sandbox(listener, LIMITS) as sandbox:
        assert sandbox.load(model(nodes, constants, opset=17)).parameters == 25_000_002
        assert sandbox.run({"speed": np.ones((1, 1), np.float32)})["steer"][0, 0] == pytest.approx(5e-6, rel=1e-3)
