"""Write a checkpoint as one ONNX file that holds the whole agent. Its contract is ``docs/models.md``."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.training.drive import begin, drive_on
from wrongturn_agents.training.export.writing import check_target, export_graph, halve, quantise, write_graph
from wrongturn_agents.training.method import Loaded, TrainedAgent, load
from wrongturn_agents.training.recording import EGOS, record_observations
from wrongturn_protocol.model_contract import ACTION, STATE_IN, STATE_OUT
from wrongturn_protocol.observations import FIELDS

CALIBRATION: Final = 200
"""Number of observations that determine int8's ranges."""
CALIBRATION_SEED: Final = 20_001
BATCH: Final = torch.export.Dim("batch", min=1, max=4096)
"""The free first axis of a graph's inputs."""
LICENCE: Final = "Apache-2.0"
"""Licence of the weights."""

Observations = Mapping[str, NDArray[Any]]


class Precision(StrEnum):
    """How weights are stored, and in which precision the file computes."""

    FP32 = "fp32"
    """As trained."""
    FP16 = "fp16"
    """Weights stored in half precision, computed in single: half the file, the same speed."""
    INT8 = "int8"
    """Convolutions and the wide layer after them in 8 bits, the rest as fp16: a quarter of the file, and faster."""


@dataclass(frozen=True)
class Agreement:
    """Difference between a file's actions and the checkpoint's, as steer, throttle and brake."""

    mean: tuple[float, float, float]
    """Mean absolute differences."""
    greatest: tuple[float, float, float]
    """Greatest absolute differences."""
    observations: int


def export(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write a checkpoint, a run's ``best.pt``, ``last.pt`` or ``privileged.pt``, as an ONNX file.

    The agent's name on the leaderboard is by default the algorithm. ``observations`` (n, ...) for each input calibrate
    int8; they are recorded by default. On recorded observations to be ``compared``, the file's actions are held
    against the checkpoint's: the file's metadata keeps the result, which is returned.
    """
    file = Path(file)
    check_target(file, name)
    loaded = load(checkpoint)
    told = {"name": name, "observations": observations, "compared": compared}
    found: Agreement | None = loaded.method.export(loaded, file, Precision(precision), **told)
    return found


def write_agent(
    loaded: Loaded,
    file: Path,
    precision: str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write an agent that drives by itself as an ONNX file; see :func:`export`."""
    keys, memory = loaded.agent.keys, begin(loaded.model, 1).shape[1]
    graph = batched_graph(_ExportedAgent(loaded.model), loaded.agent, memory, ACTION)
    if precision == Precision.INT8:
        seen = observations or record_observations(loaded.agent.track, CALIBRATION, seed=CALIBRATION_SEED)
        feed = {key: np.asarray(seen[key]) for key in keys}
        if memory:
            # Memories of 0 are those of first decisions, whose ranges are those of any other.
            feed[STATE_IN] = np.zeros((len(feed[keys[0]]), memory), np.float32)
        graph = quantise(graph, feed)
    if precision != Precision.FP32:
        halve(graph)
    onnx.checker.check_model(graph, full_check=True)
    facts = facts_of(loaded, name=name, precision=precision)
    write_graph(file, graph, facts)
    if compared is None:
        return None
    found = agreement(loaded, file, compared)
    write_graph(file, graph, facts | {"agreement": json.dumps(asdict(found), sort_keys=True)})
    return found


def facts_of(loaded: Loaded, *, name: str | None, precision: str) -> dict[str, str]:
    """Return a file's metadata. Without a name the agent has the algorithm's on the leaderboard."""
    told, agent = loaded.told, loaded.agent
    return {
        "name": name or agent.name,
        "track": str(agent.track),
        "description": agent.description,
        "algorithm": agent.name,
        "seed": str(told["seed"]),
        "steps": str(told["steps"]),
        "precision": str(precision),
        "licence": LICENCE,
        **{field: json.dumps(told[field], sort_keys=True) for field in ("config", "evaluation", "versions")},
    }


def agreement(loaded: Loaded, file: Path | str, observations: Observations) -> Agreement:
    """Compare a file's actions with its agent's, along the drives of ``record_observations``, with its memory."""
    model, session = loaded.model, open_session(Path(file))
    inputs = {key: np.asarray(observations[key]) for key in loaded.agent.keys}
    number = len(inputs[loaded.agent.keys[0]])
    memory = begin(model, min(EGOS, number))
    differences: list[NDArray[np.float32]] = []
    for first in range(0, number, EGOS):
        batch = {key: array[first : first + EGOS] for key, array in inputs.items()}
        before = memory[: number - first]  # the last cars' drives may be a row longer
        with torch.inference_mode():
            wanted, memory = drive_on(model, {key: torch.from_numpy(array) for key, array in batch.items()}, before)
        if before.shape[1]:
            batch[STATE_IN] = before.numpy()
        for i, action in enumerate(wanted.numpy()):  # one at a time, as an agent drives
            one = {key: array[i : i + 1] for key, array in batch.items()}
            differences.append(np.abs(session.run([ACTION], one)[0][0] - action))
    mean, greatest = np.mean(differences, 0).tolist(), np.max(differences, 0).tolist()
    return Agreement(tuple(mean), tuple(greatest), len(differences))


def sha256(file: Path | str) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


class _ExportedAgent(nn.Module):
    """The agent as the graph holds it: from an observation, and its memory if it has one."""

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model

    def forward(self, observation: dict[str, Tensor], state: Tensor | None = None) -> Any:
        if state is None:
            return self.model.drive(observation)
        return self.model.drive_on(observation, state)


def batched_graph(module: nn.Module, agent: TrainedAgent, memory: int, output: str, *more: str) -> onnx.ModelProto:
    """Return a graph in single precision, with a free batch axis.

    The module goes from an observation to the output, and if it remembers any numbers, from a state to the next. Other
    outputs come after these.
    """
    fields = {field.name: field for field in FIELDS[agent.track]}
    # A batch of two, because the exporter takes an axis of length one as fixed.
    example = {key: torch.from_numpy(np.ones((2, *fields[key].shape), fields[key].numpy_dtype)) for key in agent.keys}
    arguments: dict[str, Any] = {"observation": example}
    shapes: dict[str, Any] = {"observation": {key: {0: BATCH} for key in example}}
    if memory:
        arguments["state"], shapes["state"] = torch.zeros(2, memory), {0: BATCH}
    inputs, outputs = [*example, *([STATE_IN] if memory else [])], [output, *([STATE_OUT] if memory else []), *more]
    plain: Any = module.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    return export_graph(plain.eval(), arguments, inputs, outputs, shapes)
