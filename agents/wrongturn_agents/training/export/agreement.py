"""How far the actions of an exported file with a memory are from its checkpoint's."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.training.export.export import Agreement, Observations
from wrongturn_agents.training.recording import EGOS
from wrongturn_protocol.model_contract import ACTION, STATE_IN


class Remembering(Protocol):
    """An agent with a memory."""

    def begin(self, count: int) -> Tensor:
        """Return the memory of cars that begin their drives, (count, size)."""

    def drive_on(self, observation: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return steer, throttle and brake (count, 3), and the new memory."""


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
