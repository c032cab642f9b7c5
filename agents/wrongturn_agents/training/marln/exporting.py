"""One ONNX file of MaRLn: pictures and memory in, action and memory out."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
import torch
from numpy.typing import NDArray

from wrongturn_agents.models.marln import MEMORY, Marln
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.training.checkpoint import load_checkpoint
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
from wrongturn_agents.training.marln.network import marln_of
from wrongturn_agents.training.recording import EGOS, record_observations
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import ACTION, STATE_IN

DESCRIPTION: Final = (
    "Learned by Rainbow-IQN to drive by pictures, with a ResNet-18 that had learned affordances beforehand."
)
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
    facts = facts_of(told, name=name, track=Track.CAMERA, description=DESCRIPTION, precision=precision)
    onnx.checker.check_model(graph, full_check=True)
    write_graph(file, graph, facts)
    if compared is None:
        return None
    found = _agreement(model, file, compared)
    write_graph(file, graph, facts | {"agreement": json.dumps(asdict(found), sort_keys=True)})
    return found


def _agreement(model: Marln, file: Path, observations: Observations) -> Agreement:
    """Compare a file's actions with its network's, along the recorded drives and with their memory."""
    session = open_session(file)
    inputs = {key: np.asarray(observations[key]) for key in KEYS}
    memory = model.begin(min(EGOS, len(inputs["speed"]))).numpy()
    differences: list[NDArray[np.float32]] = []
    for first in range(0, len(inputs["speed"]), EGOS):
        batch: dict[str, NDArray[Any]] = {key: array[first : first + EGOS] for key, array in inputs.items()}
        with torch.inference_mode():
            wanted, kept = model.drive_on(
                {key: torch.from_numpy(array) for key, array in batch.items()}, torch.from_numpy(memory)
            )
        for i, action in enumerate(wanted.numpy()):  # one at a time, as an agent drives
            one = {key: array[i : i + 1] for key, array in batch.items()} | {STATE_IN: memory[i : i + 1]}
            differences.append(np.abs(session.run([ACTION], one)[0][0] - action))
        memory = kept.numpy()
    mean, greatest = np.mean(differences, 0).tolist(), np.max(differences, 0).tolist()
    return Agreement(tuple(mean), tuple(greatest), len(differences))
