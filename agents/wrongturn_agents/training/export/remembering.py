"""Writes agents with a memory as ONNX files, and tells how far the files' actions are from their checkpoints'."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray

from wrongturn_agents.models.lbc import WaypointAgent
from wrongturn_agents.models.marln import Marln
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.export.export import (
    CALIBRATION,
    CALIBRATION_SEED,
    Agreement,
    Observations,
    Precision,
)
from wrongturn_agents.training.export.quantisation import halve, quantise
from wrongturn_agents.training.export.writing import export_remembering, facts_of, write_graph
from wrongturn_agents.training.recording import EGOS, record_observations
from wrongturn_protocol.model_contract import ACTION, STATE_IN

Remembering = Marln | WaypointAgent


def write_remembering(
    agent: Remembering,
    keys: Sequence[str],
    memory: int,
    told: Mapping[str, Any],
    file: Path,
    precision: Precision,
    *,
    name: str | None,
    observations: Observations | None,
    compared: Observations | None,
) -> Agreement | None:
    """Write an agent with a memory as one ONNX file, and compare the two if there is something to compare them on.

    Args:
        agent: the agent in torch, on the CPU.
        keys: keys of the observation that it needs.
        memory: numbers in its memory.
        told: the contents of its checkpoint.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; the algorithm if None.
        observations: (n, ...) for each input, to calibrate int8 with; recorded if None.
        compared: recorded observations on which to compare the file's actions with the agent's. The file's metadata
            keeps the result.

    Raises:
        TrainingError: the file cannot be written.
    """
    shipped = SHIPPED_AGENTS[told["algorithm"]]
    graph = export_remembering(agent, keys, shipped.track, memory)
    if precision is Precision.INT8:
        seen = observations or record_observations(shipped.track, CALIBRATION, seed=CALIBRATION_SEED)
        feed = {key: np.asarray(seen[key]) for key in keys}
        # Memories of 0 are those of first decisions, whose ranges are those of any other.
        graph = quantise(graph, {**feed, STATE_IN: np.zeros((len(feed[keys[0]]), memory), np.float32)})
    if precision is not Precision.FP32:
        halve(graph)
    onnx.checker.check_model(graph, full_check=True)
    facts = facts_of(told, name=name, track=shipped.track, description=shipped.description, precision=precision)
    write_graph(file, graph, facts)
    if compared is None:
        return None
    found = agreement_along_drives(agent, keys, file, compared)
    write_graph(file, graph, facts | {"agreement": json.dumps(asdict(found), sort_keys=True)})
    return found


def agreement_along_drives(
    agent: Remembering, keys: Sequence[str], file: Path, observations: Observations
) -> Agreement:
    """Compare a file's actions with its agent's, along recorded drives and with the agent's memory.

    Args:
        agent: the agent in torch, on the CPU.
        keys: keys of the observation that it needs.
        file: the ONNX file.
        observations: (n, ...) for each key, as ``record_observations`` returns them.
    """
    session = open_session(file)
    inputs = {key: np.asarray(observations[key]) for key in keys}
    memory = agent.begin(min(EGOS, len(inputs[keys[0]]))).numpy()
    differences: list[NDArray[np.float32]] = []
    for first in range(0, len(inputs[keys[0]]), EGOS):
        batch: dict[str, NDArray[Any]] = {key: array[first : first + EGOS] for key, array in inputs.items()}
        memory = memory[: len(batch[keys[0]])]  # the last cars' drives may be a row longer
        with torch.inference_mode():
            wanted, kept = agent.drive_on(
                {key: torch.from_numpy(array) for key, array in batch.items()}, torch.from_numpy(memory)
            )
        for i, action in enumerate(wanted.numpy()):  # one at a time, as an agent drives
            one = {key: array[i : i + 1] for key, array in batch.items()} | {STATE_IN: memory[i : i + 1]}
            differences.append(np.abs(session.run([ACTION], one)[0][0] - action))
        memory = kept.numpy()
    mean, greatest = np.mean(differences, 0).tolist(), np.max(differences, 0).tolist()
    return Agreement(tuple(mean), tuple(greatest), len(differences))
