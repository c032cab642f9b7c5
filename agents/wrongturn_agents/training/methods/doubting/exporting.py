"""One ONNX file of a doubting agent: its doubt, its gate, the shipped agent that drives, and the compensation."""

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

import onnx
import torch
from onnx import TensorProto, helper
from torch import Tensor, nn

from wrongturn_agents.compensation import MEMORY as COMPENSATION
from wrongturn_agents.compensation import compensated
from wrongturn_agents.doubting_agent import OBEYED
from wrongturn_agents.models.doubt import LINE, MARKS, Doubt
from wrongturn_agents.models.gate import BELIEF, MEMORY, Gate, GateConfig
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import BATCH, Precision, batched_graph, facts_of
from wrongturn_agents.training.export.writing import check_target, export_graph, halve, write_graph
from wrongturn_agents.training.method import Loaded
from wrongturn_protocol import Command
from wrongturn_protocol.model_contract import ACTION, DOUBT, STATE_IN, STATE_OUT

_ASKED: Final = "asked_action"


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


class _Compensation(nn.Module):
    """The compensation, as a graph holds it."""

    def forward(self, action: Tensor, steering: Tensor, speed: Tensor, state: Tensor) -> Any:
        """Return the action for the car and the new memory; see :func:`compensated`."""
        return compensated(torch, action, steering, speed, state)


def _compensation_graph() -> onnx.ModelProto:
    widths = {"action": 3, "steering": 1, "speed": 1, "state": COMPENSATION}
    return export_graph(
        _Compensation(),
        {name: torch.ones(2, width) for name, width in widths.items()},
        [_ASKED, "steering", "speed", STATE_IN],
        [ACTION, STATE_OUT],
        {name: {0: BATCH} for name in widths},
    )


def joined(doubt: onnx.ModelProto, driving: onnx.ModelProto) -> onnx.ModelProto:
    """Return one model: the driving one gets its command from the other, and the car its compensated action.

    All see the same observation, and share one state.
    """
    compensation = _compensation_graph()
    parts = {
        "doubt.": _part(doubt, "doubt."),
        "policy.": _part(driving, "policy.", **{"command": OBEYED, ACTION: _ASKED}),
        "compensation.": _part(compensation, "compensation."),
    }
    puts = {
        put.name: put for model in (doubt, driving, compensation) for put in (*model.graph.input, *model.graph.output)
    }
    states = {
        prefix: put.type.tensor_type.shape.dim[1].dim_value
        for prefix, part in parts.items()
        for put in part.graph.input
        if put.name == prefix + STATE_IN
    }
    for name in (STATE_IN, STATE_OUT):
        puts[name].type.tensor_type.shape.dim[1].dim_value = sum(states.values())
    nodes = [
        helper.make_node("Split", [STATE_IN, "widths"], [prefix + STATE_IN for prefix in states], axis=1),
        *(node for part in parts.values() for node in part.graph.node),
        helper.make_node("Concat", [prefix + STATE_OUT for prefix in states], [STATE_OUT], axis=1),
    ]
    constants = [constant for part in parts.values() for constant in part.graph.initializer]
    constants.append(helper.make_tensor("widths", TensorProto.INT64, [len(states)], list(states.values())))
    outputs = [puts.pop(name) for name in (ACTION, STATE_OUT, DOUBT)]
    inputs = [put for name, put in puts.items() if name not in {OBEYED, _ASKED}]
    opsets: dict[str, Any] = {one.domain: one for part in parts.values() for one in part.opset_import}
    return helper.make_model(
        helper.make_graph(nodes, "doubting", inputs, outputs, constants),
        producer_name="wrongturn",
        opset_imports=list(opsets.values()),
        ir_version=driving.ir_version,
    )


def _part(model: onnx.ModelProto, prefix: str, **links: str) -> onnx.ModelProto:
    """Return a copy in which the names of inner values and of the state have a prefix.

    Other inputs and outputs keep their names or, by the links, get those of another part.
    """
    graph = model.graph
    ends = {put.name: put.name for put in (*graph.input, *graph.output) if put.name not in {STATE_IN, STATE_OUT}}
    names = {prefix + old: new for old, new in (ends | links).items()}
    part = onnx.compose.add_prefix(model, prefix)
    for node in part.graph.node:
        for values in (node.input, node.output):
            for k, value in enumerate(values):
                values[k] = names.get(value, value)
    return part
