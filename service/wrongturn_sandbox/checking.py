"""Checks a model's file by reading it alone. onnxruntime sees only what passes."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

from onnx import AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto

from wrongturn_sandbox import rules
from wrongturn_sandbox.errors import ModelRefusedError
from wrongturn_sandbox.rules import CONTROL_FLOW, DOMAINS, OPERATORS, RANDOM

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
_TYPED: Final = frozenset({"to", "dtype", "output_dtype", "stash_type", "softmax_precision"})
"""Attributes that name a type of elements."""
_ITEM_BYTES: Final = {TensorProto.DataType.Value(name): size for size, names in _TYPES_OF.items() for name in names}
"""Bytes of one element, for each type that is allowed."""


def check(content: bytes | bytearray) -> ModelProto:
    """Return the model of a file that keeps the rules.

    Write it anew for onnxruntime: then nothing that this reader does not know is left in it, and two readers cannot see
    two different models. Raises ModelRefusedError if the file is no model, or breaks a rule.
    """
    model = _parse(content)
    _check_versions(model)
    _require(
        not len(model.functions),
        "the model holds functions of its own; write them into the graph by onnx.inliner.inline_local_functions",
    )
    _require(not len(model.training_info), "the model holds training information; export it for inference")
    entries = model.metadata_props
    # Text that is not UTF-8 is read as bytes.
    texts = all(isinstance(text, str) for entry in entries for text in (entry.key, entry.value))
    _require(texts, "metadata_props: a key or value is not UTF-8; write the metadata as UTF-8")
    length = len(model.doc_string) + sum(len(entry.key) + len(entry.value) for entry in entries)
    _require(
        len(entries) <= rules.METADATA_MOST and length <= rules.METADATA_LENGTH_MOST,
        f"the metadata is too long; at most {rules.METADATA_MOST} entries and {rules.METADATA_LENGTH_MOST} characters "
        "are allowed",
    )
    _require_most(_check_graph(model.graph), rules.PARAMETERS_MOST, "the model", "parameters")
    return model


def _parse(content: bytes | bytearray) -> ModelProto:
    _require(len(content), "the file is empty; hand in an .onnx file")
    for magic, words in _OTHER_FILES:
        _require(not content.startswith(magic), f"the file is no ONNX model but {words}")
    _require(content[4:8] != b"ORTM", "the file is in onnxruntime's own format; hand in the .onnx file itself")
    text = bytes(content[:256]).lstrip().startswith((b"<", b"{", b"%PDF", b"#"))
    text = text or not any(byte < 9 or byte > 126 for byte in content[:4096])
    _require(not text, "the file is no ONNX model but text; hand in an .onnx file")
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
    graph = model.HasField("graph") and (len(model.graph.node) or len(model.graph.output))
    _require(graph, "the file holds no graph; hand in an .onnx file")
    return model


def _check_versions(model: ModelProto) -> None:
    _require(
        model.ir_version in rules.IR_VERSIONS,
        f"IR version {model.ir_version} is not read here; use {rules.IR_VERSIONS[0]} to {rules.IR_VERSIONS[-1]}",
    )
    _require(len(model.opset_import) <= 64, "the model names more than 64 sets of operators")
    versions = [entry.version for entry in model.opset_import if entry.domain in DOMAINS]
    _require(len(versions) == 1, "the model must name exactly one version of ONNX's default operators (opset)")
    _require(
        versions[0] in rules.OPSETS,
        f"opset {versions[0]} is not read here; export with opset {rules.OPSETS[0]} to {rules.OPSETS[-1]}",
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
        _require_most(found, most, "the graph", what)
    _require(not len(graph.sparse_initializer), "the graph holds sparse initialisers; store them as ordinary ones")
    parameters = sum(_check_tensor(tensor, "initialiser") for tensor in graph.initializer)
    constants = {tensor.name for tensor in graph.initializer}
    _check_values(graph, constants)
    held = [_check_node(node) for node in graph.node]
    _require_most(sum(tensors for tensors, _ in held), rules.CONSTANTS_MOST, "the graph", "tensors in attributes")
    _check_order(graph, constants)
    return parameters + sum(numbers for _, numbers in held)


def _check_values(graph: GraphProto, constants: set[str]) -> None:
    for names, what in (
        ([tensor.name for tensor in graph.initializer], "initialisers"),
        ([put.name for put in graph.input], "inputs"),
        ([put.name for put in graph.output], "outputs"),
    ):
        _require(len(set(names)) == len(names), f"two {what} have the same name; give each a name of its own")
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
        _require(
            kind == "tensor_type", f"{where}: it is no tensor; sequences, maps and optional values are not allowed"
        )
        tensor = value.type.tensor_type
        _check_type(tensor.elem_type, where)
        _check_dimensions([dimension.dim_value for dimension in tensor.shape.dim], most, where, free=True)
        _check_names([dimension.dim_param for dimension in tensor.shape.dim], f"{where}: the dim_param")


def _check_node(node: NodeProto) -> tuple[int, int]:
    """Check a node. Return how many tensors its attributes hold, and how many parameters."""
    where = f"node {_shown(node.name)} ({_shown(node.op_type)})"
    operator = node.op_type
    domain = _shown(node.domain)
    _require(node.domain in DOMAINS, f"{where}: its domain {domain} is not allowed; use ONNX's own operators alone")
    if operator not in OPERATORS:
        why = "this operator is"
        if operator in CONTROL_FLOW or operator in RANDOM:
            why = "control flow is" if operator in CONTROL_FLOW else "random numbers are"
        raise ModelRefusedError(f"{where}: {why} not allowed; docs/models.md lists the operators that are")
    ports = max(len(node.input), len(node.output))
    _require(ports <= rules.PORTS_MOST, f"{where}: more than {rules.PORTS_MOST} inputs or outputs")
    _require_most(len(node.attribute), rules.ATTRIBUTES_MOST, where, "attributes")
    _check_names([node.name, *node.input, *node.output])
    trains = operator == "Dropout" and len(node.input) > 2 and node.input[2]
    _require(not trains, f"{where}: it can be switched to training; export the model for inference")
    held = [_check_attribute(attribute, where) for attribute in node.attribute]
    return sum(tensors for tensors, _ in held), sum(parameters for _, parameters in held)


def _check_attribute(attribute: AttributeProto, where: str) -> tuple[int, int]:
    """Check an attribute. Return how many tensors it holds, and how many parameters."""
    here = f"{where}: attribute {_shown(attribute.name)}"
    graph = attribute.type in _GRAPHS or attribute.HasField("g") or len(attribute.graphs)
    _require(not graph, f"{here} holds a graph; control flow is not allowed")
    plain = not attribute.ref_attr_name and attribute.type in _NUMBERS
    sparse = attribute.HasField("sparse_tensor") or len(attribute.sparse_tensors)
    _require(plain and not sparse and not attribute.HasField("tp"), f"{here} has a type that is not allowed")
    _check_names([attribute.name], f"{where}: the attribute")
    text = attribute.name in {"value_string", "value_strings"}
    _require(not text, f"{where}: string tensors are not allowed")
    if attribute.name in _TYPED and (attribute.i or attribute.name in {"to", "dtype"}):  # 0 is that of the inputs
        _check_type(attribute.i, here)
    length = max(
        len(attribute.ints), len(attribute.floats), len(attribute.s), sum(len(words) + 1 for words in attribute.strings)
    )
    most = rules.ATTRIBUTE_LENGTH_MOST
    _require(length <= most, f"{here} is too long; at most {most} numbers")
    tensors = [*([attribute.t] if attribute.HasField("t") else ()), *attribute.tensors]
    return len(tensors), sum(_check_tensor(tensor, here) for tensor in tensors)


def _check_tensor(tensor: TensorProto, where: str) -> int:
    """Check that a tensor lies in the file, as a type that is allowed, in full. Return how many elements it has."""
    where = f"{where} {tensor.name[:64]!r}" if tensor.name else where
    _require(
        tensor.data_location == TensorProto.DEFAULT and not len(tensor.external_data),
        f"{where}: its data lie in another file; store them in the model itself "
        "(onnx.save with save_as_external_data=False)",
    )
    _require(not tensor.HasField("segment"), f"{where}: it is stored in segments, which is not allowed")
    _check_type(tensor.data_type, where)
    elements = _check_dimensions(tensor.dims, rules.PARAMETERS_MOST, where)
    _require(not len(tensor.string_data), "string tensors are not allowed")
    numbers = (tensor.float_data, tensor.int32_data, tensor.int64_data, tensor.double_data, tensor.uint64_data)
    typed = sum(map(len, numbers))
    if tensor.HasField("raw_data"):
        fits = len(tensor.raw_data) == elements * _ITEM_BYTES[tensor.data_type] and not typed
    else:
        fits = typed == elements
    if not fits:
        raise ModelRefusedError(f"{where}: its data do not have the length that its shape {list(tensor.dims)} asks for")
    return elements


def _check_type(code: int, where: str) -> None:
    _require(code != TensorProto.STRING, f"{where}: string tensors are not allowed")
    name = TensorProto.DataType.Name(code) if code in TensorProto.DataType.values() else code
    _require(code in _ITEM_BYTES, f"{where}: elements of type {name} are not allowed; use ordinary numbers")


def _check_dimensions(lengths: Sequence[int], most: int, where: str, *, free: bool = False) -> int:
    """Check a shape, and return how many elements it has; Python's numbers do not overflow.

    With ``free``, a length of 0 means any, and counts as 1.
    """
    _require_most(len(lengths), rules.AXES_MOST, where, "axes")
    _require(all(length >= 0 for length in lengths), f"{where}: a negative length in its shape")
    elements = math.prod(length or 1 for length in lengths) if free else math.prod(lengths)
    if max(elements, *lengths, 0) > most:
        raise ModelRefusedError(f"{where}: a shape of {elements} elements; at most {most} are allowed")
    return elements


def _check_order(graph: GraphProto, constants: set[str]) -> None:
    """Check that each node's inputs come before it, so that the graph has no cycle, and no name is made twice."""
    known = constants | {value.name for value in graph.input}
    for node in graph.node:
        for name in node.input:
            if name and name not in known:
                raise ModelRefusedError(
                    f"node {_shown(node.name)} ({node.op_type}): its input {_shown(name)} is made by no node "
                    "before it; the graph has a cycle, a gap or a wrong order"
                )
        for name in node.output:
            if name and name in known:
                raise ModelRefusedError(f"two nodes make a value called {_shown(name)}; give each a name of its own")
            known.add(name)
    for value in graph.output:
        _require(value.name in known, f"output {_shown(value.name)}: no node makes it")


def _check_names(names: Iterable[str], what: str = "the name") -> None:
    for name in names:
        _require(isinstance(name, str), f"{what} {_shown(name)} is not UTF-8; give it another")
        if len(name) > rules.NAME_MOST or not name.isprintable():
            raise ModelRefusedError(
                f"{what} {_shown(name)} is too long or not printable; use at most {rules.NAME_MOST} characters"
            )


def _require(keeps: object, reason: str) -> None:
    if not keeps:
        raise ModelRefusedError(reason)


def _require_most(found: int, most: int, where: str, what: str) -> None:
    if found > most:
        raise ModelRefusedError(f"{where} has {found} {what}; at most {most} are allowed")


def _shown(name: Any) -> str:
    text = name.decode(errors="replace") if isinstance(name, bytes) else str(name)
    return repr(text if len(text) <= 64 else text[:63] + "…")
