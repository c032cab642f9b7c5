"""One ONNX file of an agent of "Learning by Cheating": from an observation and a memory to an action."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray

from wrongturn_agents.models.waypoint_control import MEMORY
from wrongturn_agents.training.export.export import CALIBRATION, CALIBRATION_SEED, Precision
from wrongturn_agents.training.export.quantisation import halve, quantise
from wrongturn_agents.training.export.writing import (
    check_name,
    check_target,
    export_remembering,
    facts_of,
    write_graph,
)
from wrongturn_agents.training.lbc.checkpoints import load_agent
from wrongturn_agents.training.lbc.config import PRIVILEGED
from wrongturn_agents.training.recording import record_observations
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import STATE_IN

DESCRIPTIONS: Final = {
    "lbc": "Learned by imitation to drive by pictures, from an agent that saw the truth (Learning by Cheating).",
    PRIVILEGED: "Learned by imitation of rules to drive by a bird's-eye view of the truth; it taught lbc.",
}
"""What each agent is, for the leaderboard."""


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
    graph = export_remembering(agent, agent.keys, track, MEMORY)
    if precision is Precision.INT8:
        seen = observations or record_observations(track, CALIBRATION, seed=CALIBRATION_SEED)
        feed = {key: np.asarray(seen[key]) for key in agent.keys}
        feed[STATE_IN] = np.zeros((len(feed["speed"]), MEMORY), np.float32)
        graph = quantise(graph, feed)
    if precision is not Precision.FP32:
        halve(graph)
    onnx.checker.check_model(graph, full_check=True)
    facts = facts_of(told, name=name, track=track, description=DESCRIPTIONS[algorithm], precision=precision)
    write_graph(file, graph, facts)
