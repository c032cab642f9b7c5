"""Checks a model's file by reading it alone. onnxruntime sees only what passes."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

from onnx import AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto

from wrongturn_sandbox import rules
from wrongturn_sandbox.errors import ModelRefusedError
from wrongturn_sandbox.operators import CONTROL_FLOW, DOMAINS, OPERATORS, RANDOM

_OTHER_FILES: Final = (
    (b"PK", "a zip archive, as Stable-Baselines3 and PyTorch write them; export the model to ONNX first"),
    (b"\x1f\x8b", "a gzip archive; hand in the .onnx file itself"),
    (b"\x80", "a pickle; pickles are never read here; export the model to ONNX first"),
    (b"\x89HDF", "an HDF5 file; export the model to ONNX first"),
    (b"\x7fELF", "a program; hand in an .onnx file"),
    (b"version https://git-lfs", "a pointer of Git LFS; fetch the file itself by: git lfs pull"),
)
_GRAPHS: Final = frozenset({AttributeProto.GRAPH, AttributeProto.GRAPHS})
_NUMBERS: Final = {
    AttributeProto.AttributeType.Value(name)
    for name in ("FLOAT", "INT", "STRING", "TENSOR", "FLOATS", "INTS", "STRINGS", "TENSORS")
}
_TYPES_OF: Final = {
    1: ("BOOL", "INT8", "UINT8"),
    2: ("INT16", "UINT16", "FLOAT16", "BFLOAT16"),
    4: ("INT32", "UINT32", "FLOAT"),
    8: ("INT64", "UINT64", "DOUBLE"),
}
_ITEM_BYTES: Final = {TensorProto.DataType.Value(name): size for size, names in _TYPES_OF.items() for name in names}
"""Bytes of one element, for each type that is allowed."""


def check(content: bytes | bytearray) -> ModelProto:
    """Return the model of a file that keeps the rules.

    Write it anew for onnxruntime: then nothing that this reader does not know is left in it, and two readers cannot
    see two different models.

    Raises:
        ModelRefusedError: The file is no model, or breaks a rule.
    """
    model = _parse(content)
    _check_versions(model)
    if len(model.functions):
        raise ModelRefusedError(
            "the model holds functions of its own; write them into the graph by onnx.inliner.inline_local_functions"
        )
    if len(model.training_info):
        raise ModelRefusedError("the model holds training information; export it for inference")
    _check_metadata(model)
    parameters = _check_graph(model.graph)
    if parameters > rules.PARAMETERS_MOST:
        raise ModelRefusedError(f"the model has {parameters} parameters; at most {rules.PARAMETERS_MOST} are allowed")
    return model


def count_parameters(graph: GraphProto) -> int:
    """Return how many numbers the graph's initialisers hold."""
    return sum(math.prod(tensor.dims) for tensor in graph.initializer)


def default_opset(model: ModelProto) -> int:
    """Return the version of ONNX's default operators that the model uses."""
    return int(next(entry.version for entry in model.opset_import if entry.domain in DOMAINS))


def _parse(content: bytes | bytearray) -> ModelProto:
    if not content:
        raise ModelRefusedError("the file is empty; hand in an .onnx file")
    for magic, words in _OTHER_FILES:
        if content.startswith(magic):
            raise ModelRefusedError(f"the file is no ONNX model but {words}")
    if content[4:8] == b"ORTM":
        raise ModelRefusedError("the file is in onnxruntime's own format; hand in the .onnx file itself")
    head = bytes(content[:256]).lstrip()
    if head.startswith((b"<", b"{", b"%PDF", b"#")) or not any(byte < 9 or byte > 126 for byte in content[:4096]):
        raise ModelRefusedError("the file is no ONNX model but text; hand in an .onnx file")
    model = ModelProto()
    try:
        model.ParseFromString(bytes(content))
    except MemoryError:
        raise
    except Exception as error:  # protobuf's classes depend on how it was built
        words = str(error)
        if "memory" in words.lower() or "alloc" in words:
            raise MemoryError from None
        if "Depth" in words:
            raise ModelRefusedError("the graph is nested too deeply; control flow is not allowed") from None
        raise ModelRefusedError("the file is no ONNX model, or was cut off; check it by onnx.checker") from None
    model.DiscardUnknownFields()
    if not model.HasField("graph") or not (len(model.graph.node) or len(model.graph.output)):
        raise ModelRefusedError("the file holds no graph; hand in an .onnx file")
    return model


def _check_versions(model: ModelProto) -> None:
    if model.ir_version not in rules.IR_VERSIONS:
        raise ModelRefusedError(
            f"IR version {model.ir_version} is not read here; use {rules.IR_VERSIONS[0]} to {rules.IR_VERSIONS[-1]}"
        )
    if len(model.opset_import) > 64:
        raise ModelRefusedError("the model names more than 64 sets of operators")
    versions = [entry.version for entry in model.opset_import if entry.domain in DOMAINS]
    if len(versions) != 1:
        raise ModelRefusedError("the model must name exactly one version of ONNX's default operators (opset)")
    if versions[0] not in rules.OPSETS:
        raise ModelRefusedError(
            f"opset {versions[0]} is not read here; export with opset {rules.OPSETS[0]} to {rules.OPSETS[-1]}"
        )


def _check_metadata(model: ModelProto) -> None:
    entries = model.metadata_props
    length = len(model.doc_string) + sum(len(entry.key) + len(entry.value) for entry in entries)
    if len(entries) > rules.METADATA_MOST or length > rules.METADATA_LENGTH_MOST:
        raise ModelRefusedError(
            f"the metadata is too long; at most {rules.METADATA_MOST} entries and {rules.METADATA_LENGTH_MOST} "
            "characters are allowed"
        )


def _check_graph(graph: GraphProto) -> int:
    """Check a graph, and return how many parameters it has."""
    for found, most, what in (
        (len(graph.node), rules.NODES_MOST, "nodes"),
        (len(graph.initializer), rules.CONSTANTS_MOST, "initialisers"),
        (len(graph.value_info), rules.VALUES_MOST, "declared values"),
        (len(graph.input), rules.TENSORS_MOST + len(graph.initializer), "inputs"),
        (len(graph.output), rules.TENSORS_MOST, "outputs"),
    ):
        if found > most:
            raise ModelRefusedError(f"the graph has {found} {what}; at most {most} are allowed")
    if len(graph.sparse_initializer):
        raise ModelRefusedError("the graph holds sparse initialisers; store them as ordinary ones")
    parameters = sum(_check_tensor(tensor, "initialiser") for tensor in graph.initializer)
    constants = {tensor.name for tensor in graph.initializer}
    _check_values(graph, constants)
    tensors = 0
    for node in graph.node:
        found, held = _check_node(node)
        tensors += found
        parameters += held
    if tensors > rules.CONSTANTS_MOST:
        raise ModelRefusedError(f"the graph has {tensors} tensors in attributes; at most {rules.CONSTANTS_MOST}")
    _check_order(graph, constants)
    return parameters


def _check_values(graph: GraphProto, constants: set[str]) -> None:
    if len(constants) != len(graph.initializer):
        raise ModelRefusedError("two initialisers have the same name; give each a name of its own")
    _check_names(constants)
    values: Iterable[tuple[ValueInfoProto, int, str]] = (
        *((value, rules.INPUT_MOST, "input") for value in graph.input if value.name not in constants),
        *((value, rules.DECLARED_MOST, "input") for value in graph.input if value.name in constants),
        *((value, rules.OUTPUT_MOST, "output") for value in graph.output),
        *((value, rules.DECLARED_MOST, "value") for value in graph.value_info),
    )
    for value, most, what in values:
        _check_names([value.name])
        where = f"{what} {_shown(value.name)}"
        kind = value.type.WhichOneof("value")
        if kind is None and what == "value":
            continue  # onnxruntime finds out its type
        if kind != "tensor_type":
            raise ModelRefusedError(f"{where}: it is no tensor; sequences, maps and optional values are not allowed")
        tensor = value.type.tensor_type
        _check_type(tensor.elem_type, where)
        _check_dimensions([dimension.dim_value for dimension in tensor.shape.dim], most, where, free=True)
    for puts, what in ((graph.input, "inputs"), (graph.output, "outputs")):
        names = [put.name for put in puts]
        if len(set(names)) != len(names):
            raise ModelRefusedError(f"two {what} have the same name; give each a name of its own")


def _check_node(node: NodeProto) -> tuple[int, int]:
    """Check a node. Return how many tensors its attributes hold, and how many parameters."""
    where = f"node {_shown(node.name)} ({_shown(node.op_type)})"
    operator = node.op_type
    if node.domain not in DOMAINS:
        raise ModelRefusedError(
            f"{where}: its domain {_shown(node.domain)} is not allowed; use ONNX's own operators alone"
        )
    if operator not in OPERATORS:
        why = "this operator is"
        if operator in CONTROL_FLOW or operator in RANDOM:
            why = "control flow is" if operator in CONTROL_FLOW else "random numbers are"
        raise ModelRefusedError(f"{where}: {why} not allowed; docs/models.md lists the operators that are")
    if len(node.input) > rules.PORTS_MOST or len(node.output) > rules.PORTS_MOST:
        raise ModelRefusedError(f"{where}: more than {rules.PORTS_MOST} inputs or outputs")
    if len(node.attribute) > rules.ATTRIBUTES_MOST:
        raise ModelRefusedError(f"{where}: {len(node.attribute)} attributes; at most {rules.ATTRIBUTES_MOST}")
    _check_names([node.name, *node.input, *node.output])
    if operator == "Dropout" and len(node.input) > 2 and node.input[2]:
        raise ModelRefusedError(f"{where}: it can be switched to training; export the model for inference")
    held = [_check_attribute(attribute, where) for attribute in node.attribute]
    return sum(tensors for tensors, _ in held), sum(parameters for _, parameters in held)


def _check_attribute(attribute: AttributeProto, where: str) -> tuple[int, int]:
    name = _shown(attribute.name)
    if attribute.type in _GRAPHS or attribute.HasField("g") or len(attribute.graphs):
        raise ModelRefusedError(f"{where}: attribute {name} holds a graph; control flow is not allowed")
    if attribute.ref_attr_name or attribute.type not in _NUMBERS:
        raise ModelRefusedError(f"{where}: attribute {name} has a type that is not allowed")
    if attribute.HasField("sparse_tensor") or len(attribute.sparse_tensors) or attribute.HasField("tp"):
        raise ModelRefusedError(f"{where}: attribute {name} has a type that is not allowed")
    if attribute.name in {"value_string", "value_strings"}:
        raise ModelRefusedError(f"{where}: string tensors are not allowed")
    if attribute.name == "to" and attribute.i == TensorProto.STRING:
        raise ModelRefusedError(f"{where}: string tensors are not allowed")
    length = max(
        len(attribute.ints), len(attribute.floats), len(attribute.s), sum(len(words) + 1 for words in attribute.strings)
    )
    if length > rules.ATTRIBUTE_LENGTH_MOST:
        raise ModelRefusedError(f"{where}: attribute {name} is too long; at most {rules.ATTRIBUTE_LENGTH_MOST} numbers")
    tensors = [*([attribute.t] if attribute.HasField("t") else ()), *attribute.tensors]
    return len(tensors), sum(_check_tensor(tensor, f"{where}: attribute {name}") for tensor in tensors)


def _check_tensor(tensor: TensorProto, where: str) -> int:
    """Check that a tensor lies in the file, as a type that is allowed, in full. Return how many elements it has."""
    where = f"{where} {tensor.name[:64]!r}" if tensor.name else where
    if tensor.data_location != TensorProto.DEFAULT or len(tensor.external_data):
        raise ModelRefusedError(
            f"{where}: its data lie in another file; store them in the model itself "
            "(onnx.save with save_as_external_data=False)"
        )
    if tensor.HasField("segment"):
        raise ModelRefusedError(f"{where}: it is stored in segments, which is not allowed")
    _check_type(tensor.data_type, where)
    elements = _check_dimensions(tensor.dims, rules.PARAMETERS_MOST, where)
    if tensor.HasField("raw_data"):
        held, item = len(tensor.raw_data), _ITEM_BYTES[tensor.data_type]
        fits = held == elements * item and not _typed(tensor)
    else:
        fits = _typed(tensor) == elements
    if not fits:
        raise ModelRefusedError(f"{where}: its data do not have the length that its shape {list(tensor.dims)} asks for")
    return elements


def _check_type(code: int, where: str) -> None:
    if code == TensorProto.STRING:
        raise ModelRefusedError(f"{where}: string tensors are not allowed")
    if code not in _ITEM_BYTES:
        raise ModelRefusedError(f"{where}: elements of type {code} are not allowed; use ordinary numbers")


def _check_dimensions(lengths: Sequence[int], most: int, where: str, *, free: bool = False) -> int:
    """Check a shape, and return how many elements it has; Python's numbers do not overflow.

    With ``free``, a length of 0 means any, and counts as 1.
    """
    if len(lengths) > rules.AXES_MOST:
        raise ModelRefusedError(f"{where}: {len(lengths)} axes; at most {rules.AXES_MOST} are allowed")
    if any(length < 0 for length in lengths):
        raise ModelRefusedError(f"{where}: a negative length in its shape")
    elements = math.prod(length or 1 for length in lengths) if free else math.prod(lengths)
    largest = max(lengths, default=0)
    if elements > most or largest > most:
        raise ModelRefusedError(f"{where}: a shape of {elements} elements; at most {most} are allowed")
    return elements


def _typed(tensor: TensorProto) -> int:
    """Return how many elements lie in the fields for one type each."""
    if len(tensor.string_data):
        raise ModelRefusedError("string tensors are not allowed")
    return (
        len(tensor.float_data)
        + len(tensor.int32_data)
        + len(tensor.int64_data)
        + len(tensor.double_data)
        + len(tensor.uint64_data)
    )


def _check_order(graph: GraphProto, constants: set[str]) -> None:
    """Check that each node's inputs come before it, so that the graph has no cycle, and no name is made twice."""
    known = constants | {value.name for value in graph.input}
    made: set[str] = set()
    for node in graph.node:
        for name in node.input:
            if name and name not in known and name not in made:
                raise ModelRefusedError(
                    f"node {_shown(node.name)} ({node.op_type}): its input {_shown(name)} is made by no node "
                    "before it; the graph has a cycle, a gap or a wrong order"
                )
        for name in node.output:
            if name and (name in known or name in made):
                raise ModelRefusedError(f"two nodes make a value called {_shown(name)}; give each a name of its own")
            made.add(name)
    for value in graph.output:
        if value.name not in known and value.name not in made:
            raise ModelRefusedError(f"output {_shown(value.name)}: no node makes it")


def _check_names(names: Iterable[str]) -> None:
    for name in names:
        if len(name) > rules.NAME_MOST or not name.isprintable():
            raise ModelRefusedError(
                f"the name {_shown(name)} is too long or not printable; use at most {rules.NAME_MOST} characters"
            )


def _shown(name: Any) -> str:
    text = str(name)
    return repr(text if len(text) <= 64 else text[:63] + "…")
