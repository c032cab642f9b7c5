"""Small models that drive by rules, for the privileged track, whose observations cost no picture."""

from collections.abc import Mapping, Sequence

import numpy as np
from onnx import ModelProto, NodeProto, TensorProto, helper, numpy_helper

FLOAT = TensorProto.FLOAT
PRIVILEGED = {"track": "privileged"}


def _model(
    nodes: Sequence[NodeProto],
    constants: Mapping[str, float | Sequence[int]],
    *,
    inputs: Sequence[str] = ("speed",),
    outputs: Sequence[str] = ("steer", "accelerate"),
    metadata: Mapping[str, str] = PRIVILEGED,
) -> bytes:
    def info(name: str) -> object:
        return helper.make_tensor_value_info(name, FLOAT, (1, 1))

    def value(given: float | Sequence[int]) -> np.ndarray:
        return np.array([[given]], np.float32) if isinstance(given, float) else np.array(given, np.int64)

    initial = [numpy_helper.from_array(value(given), name) for name, given in constants.items()]
    graph = helper.make_graph(
        nodes, "graph", [info(name) for name in inputs], [info(name) for name in outputs], initial
    )
    model: ModelProto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    helper.set_model_props(model, dict(metadata))
    return model.SerializeToString()


def steady(steer: float = 0.0, accelerate: float = 0.8, **options: Mapping[str, str]) -> bytes:
    """Give the same steering and acceleration at any speed."""
    nodes = [
        helper.make_node("Mul", ["speed", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "wanted_steer"], ["steer"]),
        helper.make_node("Add", ["nothing", "wanted_accelerate"], ["accelerate"]),
    ]
    return _model(nodes, {"zero": 0.0, "wanted_steer": steer, "wanted_accelerate": accelerate}, **options)


def wavering() -> bytes:
    """Steer left and right by the number of steps, which only the state tells."""
    nodes = [
        helper.make_node("Add", ["state_in", "one"], ["state_out"]),
        helper.make_node("Mul", ["state_in", "rate"], ["phase"]),
        helper.make_node("Sin", ["phase"], ["wave"]),
        helper.make_node("Mul", ["wave", "width"], ["steer"]),
        helper.make_node("Mul", ["speed", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "gas"], ["accelerate"]),
    ]
    constants = {"one": 1.0, "rate": 0.4, "width": 0.3, "zero": 0.0, "gas": 0.6}
    inputs, outputs = ("speed", "state_in"), ("steer", "accelerate", "state_out")
    return _model(nodes, constants, inputs=inputs, outputs=outputs)


def not_a_number_above(speed: float) -> bytes:
    """Accelerate until the car is this fast; then the acceleration is the root of a negative number."""
    nodes = [
        helper.make_node("Sub", ["limit", "speed"], ["left"]),
        helper.make_node("Sqrt", ["left"], ["root"]),
        helper.make_node("Mul", ["root", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "one"], ["accelerate"]),
        helper.make_node("Mul", ["speed", "zero"], ["steer"]),
    ]
    return _model(nodes, {"limit": speed, "zero": 0.0, "one": 1.0})


def forgetful() -> bytes:
    """Remember what is not finite from the second step on."""
    nodes = [
        helper.make_node("Add", ["state_in", "one"], ["count"]),
        helper.make_node("Sub", ["one", "state_in"], ["left"]),
        helper.make_node("Div", ["count", "left"], ["state_out"]),
        helper.make_node("Mul", ["speed", "zero"], ["steer"]),
        helper.make_node("Mul", ["speed", "zero"], ["accelerate"]),
    ]
    inputs, outputs = ("speed", "state_in"), ("steer", "accelerate", "state_out")
    return _model(nodes, {"one": 1.0, "zero": 0.0}, inputs=inputs, outputs=outputs)


def slow(size: int = 1536, times: int = 40) -> bytes:
    """Multiply large matrices at each step."""
    nodes = [helper.make_node("Expand", ["speed", "large"], ["m0"])]
    nodes += [helper.make_node("MatMul", [f"m{n}", "m0"], [f"m{n + 1}"]) for n in range(times)]
    nodes += [
        helper.make_node("ReduceMax", [f"m{times}"], ["most"], keepdims=1),
        helper.make_node("Tanh", ["most"], ["accelerate"]),
        helper.make_node("Mul", ["speed", "zero"], ["steer"]),
    ]
    return _model(nodes, {"large": (size, size), "zero": 0.0})


def of_input(name: str) -> bytes:
    """Take an input of any name."""
    nodes = [helper.make_node("Identity", [name], ["steer"]), helper.make_node("Identity", [name], ["accelerate"])]
    return _model(nodes, {}, inputs=(name,))
