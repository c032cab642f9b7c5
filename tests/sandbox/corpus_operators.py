"""Models with operators that are not allowed, or whose attributes are hostile."""

import onnx.parser
from onnx import TensorProto, helper
from upload_models import STRING, By, Case, beside, control, field, ints, model, node, number


def _branch(name: str, depth: int = 0) -> onnx.GraphProto:
    inner = [node("Relu", ["speed"], [name])]
    if depth:
        inner = [
            node("If", ["yes"], [name], then_branch=_branch(f"{name}t", depth - 1), else_branch=_branch(f"{name}e"))
        ]
    return helper.make_graph(inner, name, [], [control(name)])


def _if(depth: int = 0) -> bytes:
    made = node("If", ["yes"], ["b"], then_branch=_branch("t", depth), else_branch=_branch("e"))
    return beside([made], "b", [number("yes", True, bool)])


def _nested() -> bytes:
    """Return a model of 5,000 graphs in one another, which no library would write."""
    graph = b""
    for _ in range(5000):
        graph = field(1, field(4, b"If") + field(5, field(1, b"then_branch") + field(6, graph)))
    return model() + field(7, graph)


def _loop() -> bytes:
    body = onnx.parser.parse_graph("""
        body (int64 step, bool go, float[1, 1] sum) => (bool go_on, float[1, 1] more)
        { go_on = Identity(go) more = Add(sum, sum) }
    """)
    return beside([node("Loop", ["", "yes", "speed"], ["b"], body=body)], "b", [number("yes", True, bool)])


def _scan() -> bytes:
    body = onnx.parser.parse_graph("body (float[1] x) => (float[1] y) { y = Relu(x) }")
    return beside([node("Scan", ["speed"], ["b"], body=body, num_scan_inputs=1)], "b")


def _map() -> bytes:
    body = onnx.parser.parse_graph("body (float x) => (float y) { y = Relu(x) }")
    made = [node("SequenceMap", ["s"], ["m"], body=body), node("ConcatFromSequence", ["m"], ["b"], axis=0)]
    return beside(made, "b", [number("s", 0)])


def _graph_in_disguise() -> bytes:
    hidden = node("Relu", ["speed"], ["b"])
    attribute = hidden.attribute.add(name="alpha", type=onnx.AttributeProto.FLOAT, f=1)
    attribute.g.CopyFrom(_branch("hidden"))
    return beside([hidden], "b")


def _foreign(domain: str, operator: str) -> bytes:
    return beside([helper.make_node(operator, ["speed"], ["b"], domain=domain)], "b")


def _one(operator: str, *inputs: str, **attributes: object) -> bytes:
    return beside(
        [node(operator, inputs or ["speed"], ["b"], **attributes)],
        "b",
        [ints("shape", 1, 1), number("yes", True, bool)],
    )


OPERATORS = (
    Case("if", _if, "control flow"),
    Case("if-nested", lambda: _if(15), "control flow"),
    Case("if-nested-deeply", _nested, "nested too deeply"),
    Case("loop-without-end", _loop, "control flow"),
    Case("scan", _scan, "control flow"),
    Case("sequence-map", _map, "control flow"),
    Case("graph-in-disguise", _graph_in_disguise, "holds a graph"),
    Case("custom-domain", lambda: _foreign("com.example", "Evil"), "com.example"),
    Case("runtime-domain", lambda: _foreign("com.microsoft", "Gelu"), "com.microsoft"),
    Case("machine-learning-domain", lambda: _foreign("ai.onnx.ml", "Normalizer"), "ai.onnx.ml"),
    Case("unknown-operator", lambda: _foreign("", "Shell"), "not allowed"),
    Case("random-normal", lambda: _one("RandomNormalLike"), "random numbers"),
    Case("random-choice", lambda: _one("Bernoulli"), "random numbers"),
    Case("dropout-in-training", lambda: _one("Dropout", "speed", "", "yes"), "training"),
    Case("picture-decoder", lambda: _one("ImageDecoder", "shape"), "not allowed"),
    Case(
        "strings-by-constant", lambda: beside([node("Constant", [], ["b"], value_strings=["a"])], "b"), "string tensors"
    ),
    Case("float8-by-cast", lambda: _one("Cast", to=TensorProto.FLOAT8E4M3FN), "'to': elements of type FLOAT8E4M3FN"),
    Case("int4-by-cast", lambda: _one("Cast", to=TensorProto.INT4), "'to': elements of type INT4"),
    Case(
        "float8-by-eye", lambda: _one("EyeLike", dtype=TensorProto.FLOAT8E5M2), "'dtype': elements of type FLOAT8E5M2"
    ),
    Case(
        "int4-by-quantisation",
        lambda: _one("QuantizeLinear", output_dtype=TensorProto.INT4),
        "'output_dtype': elements of type INT4",
    ),
    Case("strings-by-cast", lambda: _one("Cast", to=STRING), "string tensors"),
    Case("strings-by-operator", lambda: _one("StringNormalizer"), "not allowed"),
    Case("optional-value", lambda: _one("Optional"), "not allowed"),
    Case("sequence", lambda: _one("SequenceConstruct"), "not allowed"),
    Case("attribute-long", lambda: _one("Transpose", perm=list(range(1_000_000))), "too long"),
    Case("attribute-of-wrong-type", lambda: _one("Softmax", axis=1.5), "onnxruntime", By.LOAD),
    Case("equation-long", lambda: _one("Einsum", equation="ij," * 100_000), "too long"),
    Case("ports-many", lambda: _one("Concat", *["speed"] * 10_000, axis=0), "inputs or outputs"),
    Case("types-mixed", lambda: _one("Add", "speed", "shape"), "onnxruntime", By.LOAD),
)
"""Operators."""
