"""One ONNX file of a doubting agent: what it sees, its command gate, and the shipped agent that drives behind it."""

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

import onnx
from torch import Tensor, nn

from wrongturn_agents.doubting_agent import OBEYED
from wrongturn_agents.models.doubt import Doubt
from wrongturn_agents.models.gate import MEMORY, Gate, GateConfig
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import Precision, batched_graph, facts_of
from wrongturn_agents.training.export.writing import check_target, halve, write_graph
from wrongturn_agents.training.method import Loaded
from wrongturn_protocol.model_contract import ACTION, STATE_OUT

_PREFIX: Final = "policy."


class GatedDoubt(nn.Module):
    """What a doubting agent adds to a driving one: from an observation to the command to obey, and its memory."""

    def __init__(self, doubt: Doubt, gate: Gate) -> None:
        super().__init__()
        self.doubt = doubt
        self.gate = gate

    def forward(self, observation: dict[str, Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the command to obey (B, 1), and the new memory (B, MEMORY)."""
        exits, distance = self.doubt.tell(observation)
        command, after = self.gate(exits, distance, observation["speed"], observation["command"], state)
        return command, after


def write_doubting(
    loaded: Loaded,
    file: Path,
    precision: str = Precision.FP32,
    *,
    name: str | None = None,
    gate: GateConfig | None = None,
    whole: bool = True,
) -> None:
    """Write a doubting agent as one ONNX file.

    The precision, ``fp32`` or ``fp16``, is that of the weights that see; the driving agent's stay as they are shipped.
    Not ``whole``, the file has only what doubts, as the shipped agents have it: its output is the command to obey.
    """
    check_target(file, name)
    if precision not in {Precision.FP32, Precision.FP16}:
        raise TrainingError(f"--precision: {precision} is for agents that drive by themselves; give fp32 or fp16")
    doubt: Any = loaded.model
    settings = gate or GateConfig()
    drives = DOUBTING_AGENTS[loaded.agent.name].drives
    graph = batched_graph(GatedDoubt(doubt, Gate(settings)), loaded.agent, MEMORY, OBEYED)
    if precision == Precision.FP16:
        halve(graph)
    if whole:
        graph = joined(graph, onnx.load(SHIPPED_AGENTS[drives].file))
    onnx.checker.check_model(graph, full_check=True)
    facts = facts_of(loaded, name=name, precision=precision)
    gated = json.dumps(dataclasses.asdict(settings), sort_keys=True)
    write_graph(file, graph, {**facts, "drives": drives, "trained_on_faults": "true", "gate": gated})


def joined(doubt: onnx.ModelProto, driving: onnx.ModelProto) -> onnx.ModelProto:
    """Return one model: the driving one gets its command from the other's output, and both see the same observation."""
    shared = {put.name for put in driving.graph.input} - {"command"}
    kept = {name: name for name in (*shared, ACTION)} | {"command": OBEYED}
    other = onnx.compose.add_prefix(driving, _PREFIX)
    names = {_PREFIX + old: new for old, new in kept.items()}
    for node in other.graph.node:
        for puts in (node.input, node.output):
            for k, put in enumerate(puts):
                puts[k] = names.get(put, put)
    graph = onnx.helper.make_graph(
        [*doubt.graph.node, *other.graph.node],
        "doubting",
        [*doubt.graph.input, *(put for put in driving.graph.input if put.name in shared - _inputs(doubt))],
        [*driving.graph.output, *(put for put in doubt.graph.output if put.name == STATE_OUT)],
        [*doubt.graph.initializer, *other.graph.initializer],
    )
    opsets: dict[str, Any] = {one.domain: one for model in (doubt, other) for one in model.opset_import}
    return onnx.helper.make_model(
        graph, producer_name="wrongturn", opset_imports=list(opsets.values()), ir_version=driving.ir_version
    )


def _inputs(model: onnx.ModelProto) -> set[str]:
    return {put.name for put in model.graph.input}
