"""One ONNX file of a doubting agent: what it sees, its command gate, and the shipped agent that drives behind it."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import onnx
import torch
from onnx import TensorProto, helper
from torch import Tensor, nn

from wrongturn_agents.doubting_agent import OBEYED
from wrongturn_agents.models.doubt import LINE, MARKS, Doubt
from wrongturn_agents.models.gate import BELIEF, MEMORY, Gate, GateConfig
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import Precision, batched_graph, facts_of
from wrongturn_agents.training.export.writing import check_target, halve, write_graph
from wrongturn_agents.training.method import Loaded
from wrongturn_protocol import Command
from wrongturn_protocol.model_contract import ACTION, DOUBT, STATE_IN, STATE_OUT

_PREFIX: Final = "policy."


class GatedDoubt(nn.Module):
    """What a doubting agent adds to a driving one: from an observation to the command to obey, its memory and doubt.

    ``temperatures`` calibrate the doubt: that of the exits, and that of the stop line's distance.
    """

    def __init__(self, doubt: Doubt, gate: Gate, temperatures: tuple[float, float] = (1.0, 1.0)) -> None:
        super().__init__()
        self.doubt = doubt
        self.gate = gate
        self.temperatures = temperatures

    def forward(self, observation: dict[str, Tensor], state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the command to obey (B, 1), the new memory (B, MEMORY), and the doubt (B, 1).

        The doubt is the probability that the delivered command is wrong: that the exit it names does not exist or,
        without a direction, that the stop line is so near that one is missing.
        """
        exits, beyond = self.doubt(observation)
        command = observation["command"]
        obeyed, after = self.gate(exits, self.doubt.metres(beyond), observation["speed"], command, state)
        named = (command >= int(Command.LEFT)) & (command <= int(Command.STRAIGHT))
        belief = after[:, BELIEF].gather(1, torch.where(named, command - int(Command.LEFT), 0))
        line = beyond[:, MARKS.index(LINE) : MARKS.index(LINE) + 1]
        logit = torch.where(named, belief / self.temperatures[0], line / self.temperatures[1])
        return obeyed, after, torch.sigmoid(-logit)


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
    told = loaded.told["evaluation"].get("temperatures", {"exits": 1.0, "line": 1.0})
    gated = GatedDoubt(doubt, Gate(settings), (told["exits"], told["line"]))
    graph = batched_graph(gated, loaded.agent, MEMORY, OBEYED, DOUBT)
    if precision == Precision.FP16:
        halve(graph)
    if whole:
        graph = joined(graph, onnx.load(SHIPPED_AGENTS[drives].file))
    onnx.checker.check_model(graph, full_check=True)
    facts = facts_of(loaded, name=name, precision=precision)
    said = json.dumps(dataclasses.asdict(settings), sort_keys=True)
    write_graph(file, graph, {**facts, "drives": drives, "trained_on_faults": "true", "gate": said})


def joined(doubt: onnx.ModelProto, driving: onnx.ModelProto) -> onnx.ModelProto:
    """Return one model: the driving one gets its command from the other's output, and both see the same observation.

    If the driving one has a state too, both share one: first the gate's memory, then its own.
    """
    names = {put.name for put in driving.graph.input} - {"command", STATE_IN}
    kept = {name: name for name in (*names, ACTION)} | {"command": OBEYED}
    other = onnx.compose.add_prefix(driving, _PREFIX)
    _rename(other.graph, {_PREFIX + old: new for old, new in kept.items()})
    inputs = [*doubt.graph.input, *(put for put in driving.graph.input if put.name in names - _inputs(doubt))]
    outputs = [*driving.graph.output[:1], *doubt.graph.output[1:]]
    nodes, constants = [*doubt.graph.node, *other.graph.node], [*doubt.graph.initializer, *other.graph.initializer]
    if STATE_IN in _inputs(driving):
        own = next(put for put in driving.graph.input if put.name == STATE_IN).type.tensor_type.shape.dim[1].dim_value
        ends = {"begin": 0, "between": MEMORY, "end": MEMORY + own, "axis": 1}
        constants += [helper.make_tensor(f"state.{name}", TensorProto.INT64, [1], [at]) for name, at in ends.items()]
        gate = _rename(doubt.graph, {STATE_IN: "gate.in", STATE_OUT: "gate.out"})
        nodes = [
            helper.make_node("Slice", [STATE_IN, "state.begin", "state.between", "state.axis"], ["gate.in"]),
            helper.make_node("Slice", [STATE_IN, "state.between", "state.end", "state.axis"], [_PREFIX + STATE_IN]),
            *gate.node,
            *other.graph.node,
            helper.make_node("Concat", ["gate.out", _PREFIX + STATE_OUT], [STATE_OUT], axis=1),
        ]
        for put in (*inputs, *outputs):
            if put.name in {STATE_IN, STATE_OUT}:
                put.type.tensor_type.shape.dim[1].dim_value = MEMORY + own
    graph = helper.make_graph(nodes, "doubting", inputs, outputs, constants)
    opsets: dict[str, Any] = {one.domain: one for model in (doubt, other) for one in model.opset_import}
    return helper.make_model(
        graph, producer_name="wrongturn", opset_imports=list(opsets.values()), ir_version=driving.ir_version
    )


def _rename(graph: onnx.GraphProto, names: Mapping[str, str]) -> onnx.GraphProto:
    """Give values of a graph's nodes other names, in place."""
    for node in graph.node:
        for puts in (node.input, node.output):
            for k, put in enumerate(puts):
                puts[k] = names.get(put, put)
    return graph


def _inputs(model: onnx.ModelProto) -> set[str]:
    return {put.name for put in model.graph.input}
