"""Models that a sandbox runs, and that break the contract of a model: wrong names, types, shapes and values."""

from onnx import helper
from upload_models import FLOAT, INT64, SPEED, TAIL, By, Case, beside, control, model, node, number


def _value(operator: str, number_: float) -> bytes:
    return beside([node(operator, ["speed", "special"], ["b"])], "b", [number("special", number_)])


def _renamed(inputs: str, *outputs: str) -> bytes:
    nodes = [node("Tanh", [inputs], [outputs[0]]), *(node("Neg", [outputs[0]], [name]) for name in outputs[1:])]
    puts = [helper.make_tensor_value_info(inputs, FLOAT, [1, 1])]
    return model(nodes, inputs=puts, outputs=[control(name) for name in outputs])


def _state(shape: list[int]) -> bytes:
    puts = [SPEED, helper.make_tensor_value_info("state_in", FLOAT, [1, 4])]
    nodes = [*TAIL, node("Concat", ["state_in", "state_in"], ["state_out"], axis=1)]
    return model(nodes, inputs=puts, outputs=[control("steer"), control("accelerate"), control("state_out", shape)])


CONTRACT = (
    Case("not-a-number", lambda: _value("Add", float("nan")), "finite", By.CONTRACT),
    Case("infinity", lambda: _value("Add", float("inf")), "finite", By.CONTRACT),
    Case("input-unknown", lambda: _renamed("lidar", "steer", "accelerate"), "lidar", By.CONTRACT),
    Case("input-path", lambda: _renamed("../../etc/passwd", "steer", "accelerate"), "passwd", By.CONTRACT),
    Case("output-unknown", lambda: _renamed("speed", "wheel", "pedal"), "steer", By.CONTRACT),
    Case("output-missing", lambda: _renamed("speed", "steer"), "accelerate", By.CONTRACT),
    Case(
        "input-of-wrong-type",
        lambda: model(
            [node("Cast", ["speed"], ["s"], to=FLOAT), node("Tanh", ["s"], ["steer"]), TAIL[1]],
            inputs=[helper.make_tensor_value_info("speed", INT64, [1, 1])],
        ),
        "speed",
        By.CONTRACT,
    ),
    Case(
        "output-of-wrong-shape",
        lambda: model(
            [node("Concat", ["speed", "speed"], ["steer"], axis=1), TAIL[1]],
            outputs=[control("steer", [1, 2]), control("accelerate", [1, 2])],
        ),
        "steer",
        By.CONTRACT,
    ),
    Case("state-that-grows", lambda: _state([1, 8]), "state", By.CONTRACT),
)
"""Breaches of the contract."""
