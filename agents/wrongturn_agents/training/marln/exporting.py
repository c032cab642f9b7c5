"""One ONNX file of MaRLn: pictures and memory in, action and memory out."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Final

import numpy as np
import onnx

from wrongturn_agents.models.marln import MEMORY
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.checkpoint import load_checkpoint
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
from wrongturn_agents.training.marln.config import MarlnConfig
from wrongturn_agents.training.marln.network import marln_of
from wrongturn_agents.training.recording import record_observations
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import STATE_IN

KEYS: Final = ("speed", "steering", "command", "rgb")


def export_marln(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write a checkpoint of MaRLn as an ONNX file.

    Args:
        checkpoint: a run's ``best.pt`` or ``last.pt``.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; ``marln`` by default.
        observations: (n, ...) for each input, to calibrate int8 with; recorded by default.
        compared: recorded observations on which to compare the file's actions with the checkpoint's. The file's
            metadata keeps the result.

    Returns:
        The comparison, if there was one.

    Raises:
        TrainingError: the file is no checkpoint of MaRLn, or the ONNX file cannot be written.
    """
    file, precision = Path(file), Precision(precision)
    check_target(file)
    if name is not None:
        check_name(name)
    told = load_checkpoint(checkpoint)
    model = marln_of(told)
    graph = export_remembering(model, KEYS, Track.CAMERA, MEMORY)
    if precision is Precision.INT8:
        recorded = observations or record_observations(Track.CAMERA, CALIBRATION, seed=CALIBRATION_SEED)
        given = {key: np.asarray(recorded[key]) for key in KEYS}
        # A first decision, whose four pictures are the same, has the same ranges as any other.
        graph = quantise(graph, {**given, STATE_IN: np.zeros((len(given["speed"]), MEMORY), np.float32)})
    if precision is not Precision.FP32:
        halve(graph)
    facts = facts_of(
        told,
        name=name,
        track=Track.CAMERA,
        description=SHIPPED_AGENTS[MarlnConfig.algorithm].description,
        precision=precision,
    )
    onnx.checker.check_model(graph, full_check=True)
    write_graph(file, graph, facts)
    if compared is None:
        return None
    found = agreement_along_drives(model, KEYS, file, compared)
    write_graph(file, graph, facts | {"agreement": json.dumps(asdict(found), sort_keys=True)})
    return found
