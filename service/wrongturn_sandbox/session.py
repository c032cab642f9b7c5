"""Runs a checked model by onnxruntime, on one thread."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from onnx import TensorProto, helper

from wrongturn_sandbox import rules
from wrongturn_sandbox.checking import check
from wrongturn_sandbox.errors import ModelRefusedError
from wrongturn_sandbox.messages import DTYPES, Description, Limits, TensorInfo
from wrongturn_sandbox.reasons import out_of_memory, runtime_error

RUNTIME: Final = f"onnxruntime {onnxruntime.__version__}"
"""Name and version of the runtime."""
_TYPES: Final = {
    "tensor(float)": "float32",
    "tensor(double)": "float64",
    "tensor(float16)": "float16",
    **{f"tensor({name})": name for name in DTYPES if not name.startswith("float")},
}
_NO_MEMORY: Final = ("bad_alloc", "bad allocation", "Failed to allocate memory", "out of memory", "vector::_M_")


class Session:
    """A model's file, checked, that onnxruntime has loaded. It takes the file's bytes away.

    Raises ModelRefusedError if the file breaks a rule, or onnxruntime refuses it.
    """

    def __init__(self, file: bytearray, limits: Limits) -> None:
        self._limits = limits
        model = check(file)
        file.clear()  # the memory is the model's
        nodes = len(model.graph.node)
        parameters = sum(math.prod(tensor.dims) for tensor in model.graph.initializer)
        opset = next(entry.version for entry in model.opset_import if entry.domain in rules.DOMAINS)
        metadata = {entry.key: entry.value for entry in model.metadata_props}
        content = model.SerializeToString()
        model.Clear()  # onnxruntime needs the memory now
        self._session = self._blamed(lambda: _open(content, gpu=limits.gpu))
        inputs, outputs = (tuple(map(_info, puts())) for puts in (self._session.get_inputs, self._session.get_outputs))
        self.description = Description(inputs, outputs, opset, metadata, nodes, parameters)

    def run(self, inputs: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the outputs of one step. Raises ModelRefusedError if the model fails, or they are too large."""
        values = self._blamed(lambda: self._session.run(None, dict(inputs)))
        outputs = {
            tensor.name: np.asarray(value) for tensor, value in zip(self.description.outputs, values, strict=True)
        }
        size = sum(value.nbytes for value in outputs.values())
        if size > rules.OUTPUT_BYTES_MOST:
            raise ModelRefusedError(
                f"the outputs of a step take {size} bytes; at most {rules.OUTPUT_BYTES_MOST} are allowed"
            )
        return outputs

    def _blamed(self, call: Any) -> Any:
        try:
            return call()
        except MemoryError:
            raise ModelRefusedError(out_of_memory(self._limits)) from None
        except Exception as error:  # onnxruntime raises many classes
            words = str(error)
            if any(sign in words for sign in _NO_MEMORY):
                raise ModelRefusedError(out_of_memory(self._limits)) from None
            raise ModelRefusedError(f"onnxruntime refuses the model: {runtime_error(error)}") from None


def providers(*, gpu: bool) -> list[str]:
    """Return what the runtime may compute with."""
    return ["CUDAExecutionProvider", "CPUExecutionProvider"] if gpu else ["CPUExecutionProvider"]


def warm_up(*, gpu: bool = False) -> None:
    """Load and run a tiny model, so that whatever the runtime loads late is there before files are out of reach.

    Raises RuntimeError if the runtime cannot compute on a GPU and has to.
    """
    if gpu and hasattr(onnxruntime, "preload_dlls"):
        onnxruntime.preload_dlls()
    put = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 2]) for name in ("a", "b")]
    graph = helper.make_graph([helper.make_node("Tanh", ["a"], ["b"])], "warm", put[:1], put[1:])
    opset = helper.make_opsetid("", rules.OPSETS[-1])
    model = helper.make_model(graph, opset_imports=[opset], ir_version=rules.IR_VERSIONS[-1])
    session = _open(model.SerializeToString(), gpu=gpu)
    if session.get_providers()[0] != providers(gpu=gpu)[0]:
        raise RuntimeError("onnxruntime cannot compute on the GPU; install onnxruntime-gpu with CUDA and cuDNN")
    session.run(None, {"a": np.zeros((1, 2), np.float32)})
    try:
        session.run(None, {"a": np.zeros((3,), np.float32)})
    except Exception as error:  # a first error loads its class, and what unwinds the stack
        runtime_error(error)


def _open(content: bytes, *, gpu: bool) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # so that the same observation gives the same action
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.enable_profiling = False
    options.enable_cpu_mem_arena = False  # an arena keeps and rounds up what it takes; the limit counts all of it
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return onnxruntime.InferenceSession(content, options, providers=providers(gpu=gpu))


def _info(put: Any) -> TensorInfo:
    dtype = _TYPES.get(put.type)
    if dtype is None:
        raise ModelRefusedError(f"{put.name[:64]!r} is a {put.type}; inputs and outputs are tensors of numbers")
    shape = tuple(axis if isinstance(axis, int) and axis >= 0 else str(axis) if axis else None for axis in put.shape)
    return TensorInfo(put.name, dtype, shape)
