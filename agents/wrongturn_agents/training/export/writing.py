"""What every export shares: torch's exporter without its noise, and a file that is written all at once."""

import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import onnx
import torch
from onnx import inliner
from torch import nn

from wrongturn_agents.training.errors import TrainingError
from wrongturn_client.submitter import NAME_RULE, is_name

OPSET: Final = 18
"""Opset of the files. Torch writes it without a conversion, and every onnxruntime since 1.14 reads it."""


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

    Args:
        module: what to export.
        arguments: examples of its arguments by keyword: tensors, or dicts of them.
        inputs: names of the inputs, in the order of the arguments' tensors.
        outputs: names of the outputs.
        dynamic_shapes: free axes, by argument, as ``torch.export`` takes them; None for none.
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
    beside = file.with_name(file.name + ".part")
    try:
        beside.write_bytes(graph.SerializeToString(deterministic=True))
        beside.replace(file)
    except OSError as error:
        raise TrainingError(f"FILE: {file} cannot be written ({error.strerror}); name another") from error


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
