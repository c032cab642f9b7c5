"""What an upload of the corpus is, and small ONNX models for tests, honest and others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.parser
from onnx import TensorProto, helper, numpy_helper

FLOAT, INT64, UINT8, STRING = TensorProto.FLOAT, TensorProto.INT64, TensorProto.UINT8, TensorProto.STRING
SPEED = helper.make_tensor_value_info("speed", FLOAT, [1, 1])


class By(StrEnum):
    """Who finds out."""

    SIZE = "size"
    """The limit on an upload's size, before anything reads it."""
    CHECK = "check"
    """The check, by reading the file alone."""
    LOAD = "load"
    """The sandbox, when onnxruntime loads the model, or the file takes too much to read."""
    STEP = "step"
    """The sandbox, at a step."""
    CONTRACT = "contract"
    """The contract of a model, outside the sandbox: at its description or at an action."""


@dataclass(frozen=True)
class Case:
    """One upload."""

    name: str
    make: Callable[[], bytes]
    """Makes the file's first bytes."""
    words: str
    """Words that the reason holds, in any case of letters."""
    by: By = By.CHECK
    length: int | None = None
    """Length of the file where it is longer than its first bytes. The rest is a hole."""

    def write(self, folder: Path) -> Path:
        """Write the file into a folder, and return its path."""
        file = folder / f"{self.name}.onnx"
        with file.open("wb") as out:
            out.write(self.make())
            if self.length is not None:
                out.truncate(self.length)
        return file


def control(name: str, shape: Sequence[int] | None = (1, 1)) -> onnx.ValueInfoProto:
    """Return the declaration of a float output."""
    return helper.make_tensor_value_info(name, FLOAT, shape)


def node(operator: str, inputs: Sequence[str], outputs: Sequence[str], **attributes: Any) -> onnx.NodeProto:
    """Return a node; its name is its first output's."""
    return helper.make_node(operator, inputs, outputs, name=f"make_{outputs[0]}", **attributes)


def parsed(text: str) -> list[onnx.NodeProto]:
    """Return nodes without names of their textual form: ``b = Abs(speed)``."""
    return list(onnx.parser.parse_graph(f"graph () => () {{{text}}}").node)


def ints(name: str, *values: int) -> onnx.TensorProto:
    """Return a constant of one axis."""
    return numpy_helper.from_array(np.array(values, np.int64), name)


def number(name: str, value: float, dtype: Any = np.float32) -> onnx.TensorProto:
    """Return a constant without axes."""
    return numpy_helper.from_array(np.array(value, dtype), name)


TAIL = (node("Tanh", ["speed"], ["steer"]), node("Neg", ["steer"], ["accelerate"]))
"""Nodes of an honest model."""


def proto(
    nodes: Sequence[onnx.NodeProto] = TAIL,
    constants: Sequence[onnx.TensorProto] = (),
    *,
    inputs: Sequence[onnx.ValueInfoProto] = (SPEED,),
    outputs: Sequence[onnx.ValueInfoProto] = (control("steer"), control("accelerate")),
    opset: int = 18,
    ir: int = 9,
) -> onnx.ModelProto:
    """Return a model; without arguments an honest one."""
    graph = helper.make_graph(nodes, "graph", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=ir)
    helper.set_model_props(model, {"track": "camera"})
    return model


def model(*arguments: Any, **named: Any) -> bytes:
    """Return the file of :func:`proto`."""
    return bytes(proto(*arguments, **named).SerializeToString())


def beside(
    nodes: Sequence[onnx.NodeProto], last: str, constants: Sequence[onnx.TensorProto] = (), **named: Any
) -> bytes:
    """Return an honest model whose acceleration also depends on a value that other nodes make.

    Args:
        nodes: The nodes.
        last: The value; its sum goes in.
        constants: Their constants.
        named: Arguments of :func:`proto`.
    """
    tail = (
        node("Tanh", ["speed"], ["steer"]),
        node("ReduceSum", [last], ["summed"], keepdims=0),
        node("Cast", ["summed"], ["as_float"], to=FLOAT),
        node("Add", ["as_float", "steer"], ["accelerate"]),
    )
    return model((*nodes, *tail), constants, **named)


def field(number_: int, content: bytes) -> bytes:
    """Return a field of protobuf that holds bytes or a message, for what no library would write."""
    length, header = len(content), bytearray([number_ << 3 | 2])
    while length > 0x7F:
        header.append(length & 0x7F | 0x80)
        length >>= 7
    return bytes(header) + bytes([length]) + content
