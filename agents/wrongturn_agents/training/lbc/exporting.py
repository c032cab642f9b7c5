"""One ONNX file of an agent of "Learning by Cheating": from an observation and a memory to an action."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx

from wrongturn_agents.models.waypoint_control import MEMORY
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.export.agreement import agreement_along_drives
from wrongturn_agents.training.export.export import (
    CALIBRATION,
    CALIBRATION_SEED,
    Agreement,
    Observations,
    Precision,
)
from wrongturn_agents.training.export.quantisation import halve, quantise
from wrongturn_agents.training.export.writing import (
    check_name,
    check_target,
    export_remembering,
    facts_of,
    write_graph,
)
from wrongturn_agents.training.lbc.checkpoints import load_agent
from wrongturn_agents.training.recording import record_observations
from wrongturn_protocol.model_contract import STATE_IN


def export_lbc(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write an agent as one ONNX file.

    Args:
        checkpoint: a run's ``best.pt`` or ``privileged.pt``.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; the algorithm by default.
        observations: (n, ...) for each input, to calibrate int8 with; recorded by default.
        compared: recorded observations on which to compare the file's actions with the checkpoint's. The file's
            metadata keeps the result.

    Returns:
        The comparison, if there was one.

    Raises:
        TrainingError: the file is no checkpoint, or the ONNX file cannot be written.
    """
    file, precision = Path(file), Precision(precision)
    check_target(file)
    if name is not None:
        check_name(name)
    agent, told = load_agent(checkpoint)
    shipped = SHIPPED_AGENTS[told["algorithm"]]
    track = shipped.track
    graph = export_remembering(agent, agent.keys, track, MEMORY)
    if precision is Precision.INT8:
        seen = observations or record_observations(track, CALIBRATION, seed=CALIBRATION_SEED)
        feed = {key: np.asarray(seen[key]) for key in agent.keys}
        feed[STATE_IN] = np.zeros((len(feed["speed"]), MEMORY), np.float32)
        graph = quantise(graph, feed)
    if precision is not Precision.FP32:
        halve(graph)
    onnx.checker.check_model(graph, full_check=True)
    facts = facts_of(told, name=name, track=track, description=shipped.description, precision=precision)
    write_graph(file, graph, facts)
    if compared is None:
        return None
    found = agreement_along_drives(agent, agent.keys, file, compared)
    write_graph(file, graph, facts | {"agreement": json.dumps(asdict(found), sort_keys=True)})
    return found
