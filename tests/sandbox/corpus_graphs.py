"""Models whose graph or tensors are broken, too large, or lie elsewhere."""

from collections.abc import Sequence
from typing import Any

import onnx
from onnx import TensorProto, helper
from upload_models import FLOAT, STRING, TAIL, By, Case, beside, control, field, ints, model, node, number, proto


def _external(location: str, *, flag: bool = True) -> onnx.TensorProto:
    tensor = TensorProto(name="outside", data_type=FLOAT, dims=[4])
    if flag:
        tensor.data_location = TensorProto.EXTERNAL
    for key, value in (("location", location), ("offset", "0"), ("length", "16")):
        tensor.external_data.add(key=key, value=value)
    return tensor


def _declared(dims: Sequence[int], *, raw: bytes = b"", dtype: int = FLOAT) -> bytes:
    return beside([], "big", [TensorProto(name="big", data_type=dtype, dims=dims, raw_data=raw)])


def _changed(change: Any) -> bytes:
    made = proto()
    change(made)
    return bytes(made.SerializeToString())


def _sparse(made: onnx.ModelProto) -> None:
    sparse = made.graph.sparse_initializer.add()
    sparse.values.CopyFrom(_external("/etc/passwd"))
    sparse.values.name = "sparse"
    sparse.dims.append(1 << 40)


def _long_metadata(made: onnx.ModelProto) -> None:
    made.metadata_props.add(key="description", value="x" * 10_000_000)


def _many_metadata(made: onnx.ModelProto) -> None:
    for number_ in range(10_000):
        made.metadata_props.add(key=str(number_), value="x")


def _training(made: onnx.ModelProto) -> None:
    made.training_info.add().algorithm.node.add(op_type="Loop")


def _function(made: onnx.ModelProto) -> None:
    made.opset_import.append(helper.make_opsetid("own", 1))
    function = helper.make_function(
        "own", "Twice", ["x"], ["y"], [node("Add", ["x", "x"], ["y"])], [helper.make_opsetid("", 18)]
    )
    made.functions.append(function)
    made.graph.node[0].CopyFrom(helper.make_node("Twice", ["speed"], ["steer"], domain="own"))


def _chain(length: int) -> list[onnx.NodeProto]:
    return [node("Relu", [f"v{step}" if step else "speed"], [f"v{step + 1}"]) for step in range(length)]


def _flood() -> bytes:
    """Return a model with thirty million nodes without content: 60 MB that take gigabytes once they are read."""
    return model() + field(7, b"\x0a\x00" * 30_000_000)


GRAPHS = (
    Case("external-data-absolute", lambda: beside([], "outside", [_external("/etc/passwd")]), "another file"),
    Case("external-data-parent", lambda: beside([], "outside", [_external("../../../etc/passwd")]), "another file"),
    Case("external-data-beside", lambda: beside([], "outside", [_external("weights.bin")]), "another file"),
    Case("external-data-proc", lambda: beside([], "outside", [_external("/proc/self/environ")]), "another file"),
    Case(
        "external-data-unflagged", lambda: beside([], "outside", [_external("/etc/passwd", flag=False)]), "another file"
    ),
    Case(
        "external-data-in-a-node",
        lambda: beside([helper.make_node("Constant", [], ["c"], value=_external("/etc/passwd"))], "c"),
        "another file",
    ),
    Case("sparse-initialiser", lambda: _changed(_sparse), "sparse"),
    Case("functions", lambda: _changed(_function), "functions"),
    Case("training-information", lambda: _changed(_training), "training"),
    Case("metadata-long", lambda: _changed(_long_metadata), "metadata"),
    Case("metadata-many", lambda: _changed(_many_metadata), "metadata"),
    Case("cycle", lambda: beside([node("Add", ["speed", "b"], ["a"]), node("Relu", ["a"], ["b"])], "b"), "cycle"),
    Case("missing-value", lambda: beside([node("Relu", ["nowhere"], ["b"])], "b"), "made by no node"),
    Case(
        "two-makers", lambda: beside([node("Relu", ["speed"], ["b"]), node("Abs", ["speed"], ["b"])], "b"), "called 'b'"
    ),
    Case("two-constants", lambda: beside([], "one", [number("one", 1), number("one", 2)]), "same name"),
    Case("two-outputs", lambda: model(outputs=[control("steer"), control("steer")]), "same name"),
    Case("output-of-nobody", lambda: model(TAIL[:1]), "no node makes it"),
    Case("name-long", lambda: beside([node("Relu", ["speed"], ["x" * 100_000])], "x" * 100_000), "too long"),
    Case("name-unprintable", lambda: beside([node("Relu", ["speed"], ["a\x1b[2J"])], "a\x1b[2J"), "not printable"),
    Case("name-not-utf8", lambda: model().replace(b"make_steer", b"make_\xff\xfe\xfder"), "the name 'make_"),
    Case("metadata-not-utf8", lambda: model().replace(b"camera", b"\xff\xfemera"), "metadata_props: a key or value"),
    Case(
        "axis-name-long",
        lambda: model(inputs=[helper.make_tensor_value_info("speed", FLOAT, ["N" * 1000, 1])]),
        "input 'speed': the dim_param 'NN",
    ),
    Case("nodes-many", lambda: beside(_chain(20_000), "v20000"), "nodes; at most"),
    Case("nodes-flood", _flood, "of memory", By.LOAD),
    Case("constants-many", lambda: model(TAIL, [number(f"c{i}", i) for i in range(25_000)]), "initialisers; at most"),
    Case("shape-overflow", lambda: _declared([1 << 32, 1 << 32]), "elements; at most"),
    Case("shape-overflow-to-nothing", lambda: _declared([1 << 62, 4]), "elements; at most"),
    Case("shape-huge", lambda: _declared([1 << 40]), "elements; at most"),
    Case("shape-negative", lambda: _declared([-1, -4], raw=bytes(16)), "negative"),
    Case("shape-many-axes", lambda: _declared([1] * 5000, raw=bytes(4)), "axes"),
    Case("data-too-short", lambda: _declared([1000], raw=bytes(16)), "do not have the length"),
    Case("data-too-long", lambda: _declared([1], raw=bytes(4000)), "do not have the length"),
    Case("type-unknown", lambda: _declared([4], raw=bytes(16), dtype=77), "not allowed"),
    Case(
        "input-huge",
        lambda: model(inputs=[helper.make_tensor_value_info("speed", FLOAT, [1, 1 << 50])]),
        "elements; at most",
    ),
    Case("output-huge", lambda: model(outputs=[control("steer", [1, 1 << 62]), control("accelerate")]), "elements"),
    Case(
        "strings-as-input",
        lambda: model(inputs=[helper.make_tensor_value_info("speed", STRING, [1, 1])]),
        "string tensors",
    ),
    Case(
        "strings-as-constant",
        lambda: model(TAIL, [helper.make_tensor("words", STRING, [1], [b"x" * 1_000_000])]),
        "string tensors",
    ),
    Case(
        "sequence-as-input",
        lambda: model(inputs=[helper.make_tensor_sequence_value_info("speed", FLOAT, [1, 1])]),
        "no tensor",
    ),
    Case(
        "axis-out-of-range",
        lambda: beside([node("Gather", ["speed", "far"], ["b"])], "b", [ints("far", 1 << 40)]),
        "out of data bounds",
        By.STEP,
    ),
)
"""Graphs."""
