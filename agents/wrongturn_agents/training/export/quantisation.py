"""Smaller weights in an ONNX graph: 16 bits, and 8 bits for convolutions."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from wrongturn_agents.onnx_agent import load_onnxruntime
from wrongturn_agents.training.export.writing import quiet

_WORTH: Final = 1_000
"""Tensors with fewer numbers stay as they are."""
_WIDE: Final = 1_000_000
"""A linear layer with more weights than this is quantised too: the one between a picture and the heads."""
_STACKED: Final = 3
"""Axes of several matrices side by side."""


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
