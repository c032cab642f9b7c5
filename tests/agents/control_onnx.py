"""Small ONNX models."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
from onnx import TensorProto, helper

Shape = Sequence[int | None]


def write_model(
    file: Path,
    nodes: Iterable[onnx.NodeProto],
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape],
    *,
    opset: int = 17,
    metadata: Mapping[str, str] | None = None,
    **more: Any,
) -> Path:
    """Write a model with float32 inputs and outputs of these shapes, and return its file."""
    puts = (
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in some.items()]
        for some in (inputs, outputs)
    )
    graph = helper.make_graph(list(nodes), "graph", *puts, **more)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    file.write_bytes(model.SerializeToString())
    return file


def write_concat_model(file: Path, inputs: Sequence[str], *, output: str = "action", **more: Any) -> Path:
    """Write a model that concatenates its inputs; three of them make an action."""
    node = helper.make_node("Concat", inputs, [output], axis=1)
    return write_model(file, [node], dict.fromkeys(inputs, (1, 1)), {output: (1, len(inputs))}, **more)


def write_adder(file: Path) -> Path:
    """Write a model that remembers the sum of all speeds: it steers by the sum, and brakes by the speed."""
    nodes = [
        helper.make_node("Add", ["state_in", "speed"], ["state_out"]),
        helper.make_node("Identity", ["state_out"], ["steer"]),
        helper.make_node("Neg", ["speed"], ["accelerate"]),
    ]
    inputs, outputs = ("speed", "state_in"), ("steer", "accelerate", "state_out")
    return write_model(file, nodes, dict.fromkeys(inputs, (1, 1)), dict.fromkeys(outputs, (1, 1)))


def write_identity(file: Path, opset: int) -> Path:
    """Write a model of an opset that steers by its steering and accelerates by its speed."""
    names = {"steering": "steer", "speed": "accelerate"}
    nodes = [helper.make_node("Identity", [taken], [given]) for taken, given in names.items()]
    return write_model(file, nodes, dict.fromkeys(names, (1, 1)), dict.fromkeys(names.values(), (1, 1)), opset=opset)
