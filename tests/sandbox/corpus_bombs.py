"""Models that take memory or time without end, write much, or crash the runtime. Most look like any other."""

import numpy as np
import onnx
from onnx import numpy_helper
from upload_models import FLOAT, INT64, TAIL, By, Case, beside, ints, model, node, number, parsed

_MEMORY = "of memory"
_LARGE = 1 << 36
_SLOW = "took longer than"
_NOTHING = f"whole = Cast<to = {INT64}>(speed) nothing = Sub(whole, whole) "
_DIVISION = _NOTHING + "b = Div(whole, nothing)"


def _spread(operator: str, *sizes: int) -> bytes:
    return beside([node(operator, ["speed", "sizes"], ["b"])], "b", [ints("sizes", *sizes)])


def _fill(*shape: int) -> bytes:
    return beside([node("ConstantOfShape", ["shape"], ["b"])], "b", [ints("shape", *shape)])


def _at_a_step(operator: str, *inputs: str) -> bytes:
    """Return a model whose operator takes ``live``: 2 to the power of 36 at a step, and unknown when it is loaded."""
    text = f"""
        still = Abs(speed) speed0 = ReduceMax<keepdims = 0>(still) nothing = Min(speed0, zero)
        size0 = Add(nothing, size) live = Cast<to = {INT64}>(size0) shape = Reshape(live, minus)
        b = {operator}({", ".join(inputs)})
    """
    constants = [
        number("zero", 0),
        number("size", float(_LARGE)),
        ints("minus", -1),
        number("start", 0, np.int64),
        number("one", 1, np.int64),
        ints("pair", 0, 1),
    ]
    return beside(parsed(text), "b", constants)


def _matrices(count: int, width: int, *, live: bool) -> bytes:
    """Return a model that multiplies matrices: ``2 count width³`` operations."""
    first = node("Expand", ["speed" if live else "seed", "shape"], ["m0"])
    products = [node("MatMul", [f"m{step}", f"m{step}"], [f"m{step + 1}"]) for step in range(count)]
    constants = [ints("shape", width, width), numpy_helper.from_array(np.zeros((1, 1), np.float32), "seed")]
    return beside([first, *products], f"m{count}", constants)


def _outer() -> bytes:
    text = "column = ConstantOfShape(tall) row = ConstantOfShape(wide) b = MatMul(column, row)"
    return beside(parsed(text), "b", [ints("tall", 1 << 18, 1), ints("wide", 1, 1 << 18)])


def _multiplying() -> bytes:
    grown = [node("Concat", [f"d{step}" if step else "speed"] * 250, [f"d{step + 1}"], axis=0) for step in range(8)]
    return beside(grown, "d8")


def _conv() -> bytes:
    constants = [ints("shape", 1, 1, 30_000, 30_000), numpy_helper.from_array(np.ones((64, 1, 3, 3), np.float32), "w")]
    return beside(parsed("x = Expand(speed, shape) b = Conv(x, w)"), "b", constants)


def _resize() -> bytes:
    constants = [ints("shape", 1, 1, 1, 1), numpy_helper.from_array(np.array([1, 1, 1e6, 1e6], np.float32), "scales")]
    made = [node("Reshape", ["speed", "shape"], ["x"]), node("Resize", ["x", "", "scales"], ["b"], mode="linear")]
    return beside(made, "b", constants)


def _wide_outputs() -> bytes:
    made = [TAIL[0], *parsed("accelerate = Expand(steer, shape)")]
    return model(made, [ints("shape", 4_000_000, 1)], outputs=[_free("steer"), _free("accelerate")])


def _free(name: str) -> onnx.ValueInfoProto:
    return onnx.helper.make_tensor_value_info(name, FLOAT, ["n", 1])


def _crash() -> bytes:
    """Return a model that divides the least integer by -1, which the processor answers by SIGFPE."""
    text = "low = Add(nothing, least) b = Div(low, minus)"
    return beside(parsed(_NOTHING + text), "b", [ints("least", -(1 << 63)), ints("minus", -1)])


BOMBS = (
    Case("memory-constant-of-shape", lambda: _fill(_LARGE), _MEMORY, By.STEP),
    Case("memory-constant-overflow", lambda: _fill(1 << 40, 1 << 40), "overflow", By.STEP),
    Case("memory-constant-negative", lambda: _fill(-1, -(1 << 62)), "non-negative", By.LOAD),
    Case("memory-expand", lambda: _spread("Expand", 1 << 18, 1 << 18), _MEMORY, By.STEP),
    Case("memory-tile", lambda: _spread("Tile", 1 << 15, 3 << 13), _MEMORY, By.STEP),
    Case("memory-pad", lambda: _spread("Pad", 0, 0, 0, _LARGE), _MEMORY, By.STEP),
    Case("memory-resize", _resize, _MEMORY, By.STEP),
    Case("memory-outer-product", _outer, _MEMORY, By.STEP),
    Case("memory-multiplying", _multiplying, _MEMORY, By.STEP),
    Case("memory-convolution", _conv, _MEMORY, By.STEP),
    Case("memory-at-a-step-constant", lambda: _at_a_step("ConstantOfShape", "shape"), _MEMORY, By.STEP),
    Case("memory-at-a-step-range", lambda: _at_a_step("Range", "start", "live", "one"), _MEMORY, By.STEP),
    Case("memory-at-a-step-one-hot", lambda: _at_a_step("OneHot", "shape", "live", "pair"), _MEMORY, By.STEP),
    Case("time-at-loading", lambda: _matrices(400, 4000, live=False), _SLOW, By.LOAD),
    Case("time-at-a-step", lambda: _matrices(400, 4000, live=True), _SLOW, By.STEP),
    Case("outputs-large", _wide_outputs, "bytes; at most", By.STEP),
    Case("crash", _crash, "crashes", By.STEP),
    Case("division-by-nothing", lambda: beside(parsed(_DIVISION), "b"), "division by zero", By.STEP),
)
"""Bombs."""
