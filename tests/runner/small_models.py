"""Small models that drive by rules, for the privileged track, whose observations cost no picture."""

from collections.abc import Mapping, Sequence

import onnx.parser
from onnx import ModelProto, helper

PRIVILEGED = {"track": "privileged"}
_WITH_STATE = {"inputs": ("speed", "state_in"), "outputs": ("steer", "accelerate", "state_out")}


def _parsed(
    nodes: str,
    inputs: Sequence[str] = ("speed",),
    outputs: Sequence[str] = ("steer", "accelerate"),
    metadata: Mapping[str, str] = PRIVILEGED,
    **constants: float,
) -> ModelProto:
    """Return a model whose nodes are in ONNX's textual form. All values have one number."""
    taken, given = (", ".join(f"float[1, 1] {name}" for name in names) for names in (inputs, outputs))
    initial = ", ".join(f"float[1, 1] {name} = {{{number}}}" for name, number in {"zero": 0.0, **constants}.items())
    head = '<ir_version: 8, opset_import: ["": 17]>'
    model: ModelProto = onnx.parser.parse_model(f"{head} graph ({taken}) => ({given}) <{initial}> {{{nodes}}}")
    helper.set_model_props(model, dict(metadata))
    return model


def _model(nodes: str, **options: object) -> bytes:
    return _parsed(nodes, **options).SerializeToString()  # type: ignore[arg-type]


def steady(steer: float = 0.0, accelerate: float = 0.8, **options: Mapping[str, str]) -> bytes:
    """Give the same steering and acceleration at any speed."""
    nodes = "nothing = Mul(speed, zero) steer = Add(nothing, left) accelerate = Add(nothing, gas)"
    return _model(nodes, left=steer, gas=accelerate, **options)


def wavering() -> bytes:
    """Steer left and right by the number of steps, which only the state tells."""
    nodes = """
        state_out = Add(state_in, one) phase = Mul(state_in, rate) wave = Sin(phase) steer = Mul(wave, width)
        nothing = Mul(speed, zero) accelerate = Add(nothing, gas)
    """
    return _model(nodes, one=1.0, rate=0.4, width=0.3, gas=0.6, **_WITH_STATE)


def not_a_number_above(speed: float) -> bytes:
    """Accelerate until the car is this fast; then the acceleration is the root of a negative number."""
    nodes = """
        left = Sub(limit, speed) root = Sqrt(left) nothing = Mul(root, zero) accelerate = Add(nothing, one)
        steer = Mul(speed, zero)
    """
    return _model(nodes, limit=speed, one=1.0)


def forgetful() -> bytes:
    """Remember what is not finite from the second step on."""
    nodes = """
        count = Add(state_in, one) left = Sub(one, state_in) state_out = Div(count, left)
        steer = Mul(speed, zero) accelerate = Mul(speed, zero)
    """
    return _model(nodes, one=1.0, **_WITH_STATE)


def slow(size: int = 1536, times: int = 40) -> bytes:
    """Multiply large matrices at each step."""
    products = " ".join(f"m{n + 1} = MatMul(m{n}, m0)" for n in range(times))
    nodes = f"""
        large = Constant<value_ints = [{size}, {size}]>() m0 = Expand(speed, large) {products}
        most = ReduceMax<keepdims = 1>(m{times}) accelerate = Tanh(most) steer = Mul(speed, zero)
    """
    return _model(nodes)


def of_input(name: str) -> bytes:
    """Take an input of any name."""
    model = _parsed("steer = Identity(speed) accelerate = Identity(speed)")
    model.graph.input[0].name = name
    for node in model.graph.node:
        node.input[0] = name
    return model.SerializeToString()
