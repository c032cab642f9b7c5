"""Random convolutional network as an ONNX file: an untrained agent that drives by pixels."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def write_random_convolution(file: Path, seed: int = 0) -> Path:
    """Return two strided convolutions over ``rgb``, the mean of their features with the speed, and three actions."""
    draw = np.random.default_rng(seed)

    def weights(name: str, *shape: int, scale: float) -> onnx.TensorProto:
        return numpy_helper.from_array(draw.normal(0, scale, shape).astype(np.float32), name)

    nodes = [
        helper.make_node("Cast", ["rgb"], ["floats"], to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["floats"], ["planes"], perm=[0, 3, 1, 2]),
        helper.make_node("Mul", ["planes", "share"], ["scaled"]),
        helper.make_node("Conv", ["scaled", "w1"], ["c1"], strides=[4, 4]),
        helper.make_node("Relu", ["c1"], ["r1"]),
        helper.make_node("Conv", ["r1", "w2"], ["c2"], strides=[2, 2]),
        helper.make_node("Relu", ["c2"], ["r2"]),
        helper.make_node("GlobalAveragePool", ["r2"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["features"]),
        helper.make_node("Concat", ["features", "speed"], ["all"], axis=1),
        helper.make_node("Gemm", ["all", "w3", "b3"], ["raw"]),
        helper.make_node("Tanh", ["raw"], ["action"]),
    ]
    initialisers = [
        numpy_helper.from_array(np.array(1 / 255, np.float32), "share"),
        weights("w1", 8, 3, 8, 8, scale=0.1),
        weights("w2", 16, 8, 4, 4, scale=0.1),
        weights("w3", 17, 3, scale=0.1),
        numpy_helper.from_array(np.array([0.0, 0.6, -0.5], np.float32), "b3"),
    ]
    inputs = [
        helper.make_tensor_value_info("rgb", TensorProto.UINT8, [1, 64, 192, 3]),
        helper.make_tensor_value_info("speed", TensorProto.FLOAT, [1, 1]),
    ]
    outputs = [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 3])]
    graph = helper.make_graph(nodes, "random", inputs, outputs, initialisers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, file)
    return file
