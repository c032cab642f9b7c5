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
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.checkpoint import load_checkpoint, model_of
from wrongturn_agents.training.export.quantisation import halve, quantise
from wrongturn_agents.training.export.writing import check_target, export_graph, facts_of, write_graph
from wrongturn_agents.training.recording import record_observations
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import ACTION

CALIBRATION: Final = 200
"""Number of observations that determine int8's ranges."""
CALIBRATION_SEED: Final = 20_001
_BATCH: Final = 50
_MEASURED: Final = ("speed", "steering", "command")

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


class _ExportedAgent(nn.Module):
    """The agent as the graph holds it, from an observation to steer, throttle and brake."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        action: Tensor = self.model.drive(observation)  # type: ignore[operator]
        return action


def export(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write a checkpoint as an ONNX file.

    Args:
        checkpoint: a run's ``best.pt`` or ``last.pt``.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; the algorithm by default.
        observations: (n, ...) for each input, to calibrate int8 with; recorded by default.
        compared: observations on which to compare the file's actions with the checkpoint's. The file's metadata keeps
            the result.

    Returns:
        The comparison, if there was one.

    Raises:
        TrainingError: the file is no checkpoint, or the ONNX file cannot be written.
    """
    file = Path(file)
    check_target(file, name)
    told = load_checkpoint(Path(checkpoint))
    algorithm, precision = told["algorithm"], Precision(precision)
    keys = inputs_of(algorithm)
    graph = _graph(model_of(told), keys)
    if precision is Precision.INT8:
        recorded = observations or record_observations(
            SHIPPED_AGENTS[algorithm].track, CALIBRATION, seed=CALIBRATION_SEED
        )
        graph = quantise(graph, {key: np.asarray(recorded[key]) for key in keys})
    if precision is not Precision.FP32:
        halve(graph)
    shipped = SHIPPED_AGENTS[algorithm]
    facts = facts_of(told, name=name, track=shipped.track, description=shipped.description, precision=precision)
    onnx.checker.check_model(graph, full_check=True)
    write_graph(file, graph, facts)
    if compared is None:
        return None
    found = agreement(checkpoint, file, compared)
    write_graph(file, graph, facts | {"agreement": json.dumps(asdict(found), sort_keys=True)})
    return found


def inputs_of(algorithm: str) -> tuple[str, ...]:
    """Return the observation keys that an algorithm's agent needs."""
    seen = "segmentation" if SHIPPED_AGENTS[algorithm].track is Track.SEGMENTATION else "rgb"
    return (*_MEASURED, seen)


def agreement(checkpoint: Path | str, file: Path | str, observations: Observations) -> Agreement:
    """Compare a file's actions with its checkpoint's.

    Args:
        checkpoint: checkpoint of which the file was made.
        file: the ONNX file.
        observations: (n, ...) for each input.
    """
    told = load_checkpoint(Path(checkpoint))
    keys = inputs_of(told["algorithm"])
    model, session = model_of(told), open_session(Path(file))
    inputs = {key: np.asarray(observations[key]) for key in keys}
    number = len(inputs[keys[0]])
    differences = []
    for first in range(0, number, _BATCH):
        batch = {key: array[first : first + _BATCH] for key, array in inputs.items()}
        with torch.inference_mode():
            wanted = model.drive({key: torch.from_numpy(array) for key, array in batch.items()}).numpy()
        for i, action in enumerate(wanted):  # one at a time, as an agent drives
            one = {key: array[i : i + 1] for key, array in batch.items()}
            differences.append(np.abs(session.run([ACTION], one)[0][0] - action))
    mean, greatest = np.mean(differences, 0).tolist(), np.max(differences, 0).tolist()
    return Agreement(tuple(mean), tuple(greatest), len(differences))


def sha256(file: Path | str) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _graph(model: nn.Module, keys: tuple[str, ...]) -> onnx.ModelProto:
    """Return the agent's graph in single precision, with a free batch axis."""
    shapes = {"speed": (1,), "steering": (1,), "command": (1,), "rgb": (64, 192, 3), "segmentation": (64, 192)}
    dtypes = {"speed": torch.float32, "steering": torch.float32, "command": torch.int64}
    # A batch of two, because the exporter takes an axis of length one as fixed.
    example = {key: torch.ones((2, *shapes[key]), dtype=dtypes.get(key, torch.uint8)) for key in keys}
    batch = torch.export.Dim("batch", min=1, max=4096)
    return export_graph(
        _ExportedAgent(model.to(memory_format=torch.contiguous_format)).eval(),  # type: ignore[call-overload]
        {"observation": example},
        keys,
        (ACTION,),
        {"observation": {key: {0: batch} for key in keys}},
    )
