"""One ONNX file of an agent of "Learning by Cheating": from an observation and a memory to an action."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wrongturn_agents.models.lbc import WaypointAgent
from wrongturn_agents.models.waypoint_control import MEMORY
from wrongturn_agents.training.export.export import CALIBRATION, LICENCE, Precision
from wrongturn_agents.training.export.quantisation import halve, quantise
from wrongturn_agents.training.export.writing import check_name, check_target, export_graph, write_graph
from wrongturn_agents.training.lbc.checkpoints import load_agent
from wrongturn_agents.training.lbc.config import PRIVILEGED
from wrongturn_agents.training.recording import record_observations
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import ACTION, STATE_IN, STATE_OUT
from wrongturn_protocol.observations import FIELDS

DESCRIPTIONS: Final = {
    "lbc": "Learned by imitation to drive by pictures, from an agent that saw the truth (Learning by Cheating).",
    PRIVILEGED: "Learned by imitation of rules to drive by a bird's-eye view of the truth; it taught lbc.",
}
"""What each agent is, for the leaderboard."""
_CALIBRATION_SEED: Final = 20_001


class _Driving(nn.Module):
    """The agent as the graph holds it."""

    def __init__(self, agent: WaypointAgent) -> None:
        super().__init__()
        self.agent = agent

    def forward(self, observation: dict[str, Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        return self.agent.drive_on(observation, state)


def export_lbc(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Write an agent as one ONNX file.

    Args:
        checkpoint: a run's ``best.pt`` or ``privileged.pt``.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; the algorithm by default.
        observations: (n, ...) for each input, to calibrate int8 with; recorded by default.

    Raises:
        TrainingError: the file is no checkpoint, or the ONNX file cannot be written.
    """
    file, precision = Path(file), Precision(precision)
    check_target(file)
    if name is not None:
        check_name(name)
    agent, told = load_agent(checkpoint)
    algorithm = told["algorithm"]
    track = Track.PRIVILEGED if algorithm == PRIVILEGED else Track.CAMERA
    graph = _graph(agent, track)
    if precision is Precision.INT8:
        seen = observations or record_observations(track, CALIBRATION, seed=_CALIBRATION_SEED)
        feed = {key: np.asarray(seen[key]) for key in agent.keys}
        feed[STATE_IN] = np.zeros((len(feed["speed"]), MEMORY), np.float32)
        graph = quantise(graph, feed)
    if precision is not Precision.FP32:
        halve(graph)
    onnx.checker.check_model(graph, full_check=True)
    write_graph(
        file,
        graph,
        {
            "name": name or algorithm,
            "track": str(track),
            "description": DESCRIPTIONS[algorithm],
            "algorithm": algorithm,
            "seed": str(told["seed"]),
            "steps": str(told["steps"]),
            "precision": str(precision),
            "licence": LICENCE,
            **{field: json.dumps(told[field], sort_keys=True) for field in ("config", "evaluation", "versions")},
        },
    )


def _graph(agent: WaypointAgent, track: Track) -> onnx.ModelProto:
    """Return the agent's graph in single precision, with a free batch axis."""
    fields = {field.name: field for field in FIELDS[track]}
    # A batch of two, because the exporter takes an axis of length one as fixed.
    example = {key: torch.from_numpy(np.ones((2, *fields[key].shape), fields[key].numpy_dtype)) for key in agent.keys}
    batch = torch.export.Dim("batch", min=1, max=4096)
    return export_graph(
        _Driving(agent.to(memory_format=torch.contiguous_format)).eval(),  # type: ignore[call-overload]
        {"observation": example, "state": torch.zeros(2, MEMORY)},
        [*agent.keys, STATE_IN],
        [ACTION, STATE_OUT],
        {"observation": {key: {0: batch} for key in agent.keys}, "state": {0: batch}},
    )
