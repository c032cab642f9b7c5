"""What every export shares: the graph from torch, smaller weights in it, and a file that is written all at once."""

import logging
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, inliner, numpy_helper
from torch import nn

from wrongturn_agents.onnx_agent import load_onnxruntime
from wrongturn_agents.training.errors import TrainingError
from wrongturn_client.submitter import NAME_RULE, is_name
from wrongturn_protocol.json_output import write_whole

OPSET: Final = 18
"""Opset of the files. Torch writes it without a conversion, and every onnxruntime since 1.14 reads it."""
_WORTH: Final = 1_000
"""Tensors with fewer numbers stay as they are."""
_WIDE: Final = 1_000_000
"""A linear layer with more weights than this is quantised too: the one between a picture and the heads."""
_STACKED: Final = 3
"""Axes of several matrices side by side."""


def check_target(file: Path, name: str | None = None, said: str = "FILE") -> None:
    """Check before any work that a file, which the user calls ``said``, can be written, and its agent have the name."""
    if file.is_dir() or not file.absolute().parent.is_dir():
        raise TrainingError(f"{said}: {file} cannot be written; name a file in a directory that exists")
    if file.suffix != ".onnx":
        raise TrainingError(f"{said}: {file} does not end with .onnx; give it that ending")
    if name is not None and not is_name(name):
        raise TrainingError(f"--name: {name!r} cannot be one; {NAME_RULE}")


def export_graph(
    module: nn.Module,
    arguments: Mapping[str, Any],
    inputs: Sequence[str],
    outputs: Sequence[str],
    dynamic_shapes: Mapping[str, Any] | None = None,
) -> onnx.ModelProto:
    """Return a module's graph, without notes that name this machine's folders.

    Arguments are examples by keyword: tensors, or dicts of them. Inputs are names in the order of these tensors, and
    ``dynamic_shapes`` free axes by argument, as ``torch.export`` takes them.
    """
    # Messages are about optional packages and the exporter's own deprecations.
    with quiet("torch.onnx._internal.exporter._registration"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module,
            kwargs=dict(arguments),
            dynamo=True,
            opset_version=OPSET,
            dynamic_shapes=None if dynamic_shapes is None else dict(dynamic_shapes),
            input_names=list(inputs),
            output_names=list(outputs),
            verbose=False,
        )
    assert program is not None
    proto: onnx.ModelProto = program.model_proto
    if proto.functions:
        proto = inliner.inline_local_functions(proto)
    _strip(proto)
    return proto


def write_graph(file: Path, graph: onnx.ModelProto, facts: Mapping[str, str]) -> None:
    """Write a file all at once, with its metadata."""
    onnx.helper.set_model_props(graph, dict(facts))
    try:
        write_whole([graph.SerializeToString(deterministic=True)], file)
    except OSError as error:
        raise TrainingError(f"FILE: {file} cannot be written ({error.strerror}); name another") from error


def halve(model: onnx.ModelProto) -> None:
    """Store float32 weights as float16, in place.

    A cast before each makes them float32 again when the file is loaded.

    onnxruntime has no half-precision convolutions on most processors, so computing in float16 would be slower.
    """
    graph = model.graph
    casts = []
    for tensor in list(graph.initializer):
        if tensor.data_type != TensorProto.FLOAT or np.prod(tensor.dims) < _WORTH:
            continue
        half = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), f"{tensor.name}.half")
        graph.initializer.remove(tensor)
        graph.initializer.append(half)
        casts.append(helper.make_node("Cast", [half.name], [tensor.name], to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)


def quantise(model: onnx.ModelProto, observations: Mapping[str, NDArray[Any]]) -> onnx.ModelProto:
    """Return the graph with its convolutions, and the wide layer after them, in 8 bits. The heads stay float.

    Quantisation is static, with quantise-dequantise pairs and weights per output channel. Weights take 7 of the 8 bits:
    on processors without special instructions (VNNI), sums of 8-bit products saturate, and an agent would drive
    differently.

    Args:
        model: the graph in float32.
        observations: (n, ...) for each input. The range of each activation is its range over them.
    """
    load_onnxruntime()
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static  # noqa: PLC0415 - slow to load

    number = len(next(iter(observations.values())))

    class Reader(CalibrationDataReader):
        def __init__(self) -> None:
            self.left = iter(range(number))

        def get_next(self) -> dict[str, NDArray[Any]] | None:
            i = next(self.left, None)
            return None if i is None else {key: array[i : i + 1] for key, array in observations.items()}

    with tempfile.TemporaryDirectory() as folder, quiet():  # onnxruntime advises steps that are done
        plain, quantised = Path(folder, "plain.onnx"), Path(folder, "quantised.onnx")
        onnx.save(model, plain)
        quantize_static(
            plain,
            quantised,
            Reader(),
            quant_format=QuantFormat.QDQ,
            nodes_to_quantize=[node.name for node in model.graph.node if _is_wide(node, model.graph)],
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        small: onnx.ModelProto = onnx.load(quantised)
    small.producer_name, small.producer_version = model.producer_name, model.producer_version
    del small.metadata_props[:]
    return small


def _is_wide(node: onnx.NodeProto, graph: onnx.GraphProto) -> bool:
    least = {"Conv": _WORTH, "Gemm": _WIDE, "MatMul": _WIDE}.get(node.op_type)
    # onnxruntime cannot multiply by several matrices side by side in 8 bits, as the heads of the commands are.
    weights = {tensor.name: np.prod(tensor.dims) for tensor in graph.initializer if len(tensor.dims) != _STACKED}
    return least is not None and any(weights.get(name, 0) > least for name in node.input)


def _strip(proto: onnx.ModelProto) -> None:
    """Remove the notes about each node's source, which name this machine's folders."""
    proto.producer_name, proto.producer_version, proto.doc_string = "wrongturn", "", ""
    graph = proto.graph
    graph.doc_string = ""
    for part in (proto, graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer):
        del part.metadata_props[:]
        part.doc_string = ""


@contextmanager
def quiet(name: str | None = None) -> Iterator[None]:
    """Silence what is less than an error of a logger, or of the root."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
