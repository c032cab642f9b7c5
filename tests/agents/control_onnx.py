"""Small ONNX models with controls of their own and a memory."""

from pathlib import Path

import onnx
from onnx import TensorProto, helper


def write_adder(file: Path) -> Path:
    """Return a model that remembers the sum of all speeds: it steers by the sum, and brakes by the speed."""
    nodes = [
        helper.make_node("Add", ["state_in", "speed"], ["state_out"]),
        helper.make_node("Identity", ["state_out"], ["steer"]),
        helper.make_node("Neg", ["speed"], ["accelerate"]),
    ]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1]) for name in ("speed", "state_in")]
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1]) for name in ("steer", "accelerate", "state_out")
    ]
    graph = helper.make_graph(nodes, "adder", inputs, outputs)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), file)
    return file


def write_identity(file: Path, opset: int) -> Path:
    """Return a model of an opset that steers by its steering and accelerates by its speed."""
    names = (("steering", "steer"), ("speed", "accelerate"))
    graph = helper.make_graph(
        [helper.make_node("Identity", [taken], [given]) for taken, given in names],
        "identity",
        [helper.make_tensor_value_info(taken, TensorProto.FLOAT, [1, 1]) for taken, _ in names],
        [helper.make_tensor_value_info(given, TensorProto.FLOAT, [1, 1]) for _, given in names],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8), file)
    return file
