"""What the actions of a policy of Stable-Baselines3 mean: steer and accelerate, or steer, throttle and brake."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.training.action import ACTION_SPACE, controls
from wrongturn_agents.training.errors import TrainingError
from wrongturn_protocol.model_contract import CONTROLS
from wrongturn_protocol.observations import action_space
from wrongturn_protocol.space_text import in_short

_TABLE = "a JSON list with [steer, accelerate] or [steer, throttle, brake] for each action, such as [[0, 0.5], [0, -1]]"


@dataclass(frozen=True)
class Meaning:
    """How a policy's actions become controls."""

    outputs: tuple[str, ...]
    """Names of the controls, as the contract of a model has them."""
    table: NDArray[np.float32] | None = None
    """(n, 2) or (n, 3): controls of each discrete action; None if an action is the controls."""

    def controls(self, action: NDArray[Any]) -> NDArray[np.float32]:
        """Return steer, throttle and brake, (3,), of an action from ``predict``."""
        given = action if self.table is None else self.table[int(action)]
        return controls(given) if len(self.outputs) == 2 else np.asarray(given, np.float32)


def meaning_of(space: spaces.Space[Any], file: Path | None) -> Meaning:
    """Return what the actions of a space mean.

    Args:
        space: the policy's action space: one of our environments', or discrete.
        file: JSON file with the controls of each discrete action.
    """
    if isinstance(space, spaces.Discrete):
        if file is None:
            raise TrainingError(f"--actions: is missing: the policy has {space.n} discrete actions; name {_TABLE}")
        table = _table(file, int(space.n))
        return Meaning(CONTROLS[table.shape[1] - 2], table)
    if file is not None:
        raise TrainingError(f"--actions: is for discrete actions, and the policy's are {in_short(space)}; leave it out")
    for ours, outputs in ((ACTION_SPACE, CONTROLS[0]), (action_space(), CONTROLS[1])):
        if space == ours:
            return Meaning(outputs)
    raise TrainingError(
        f"action space: {in_short(space)} is none of ours; train with {action_space()} (steer, throttle, brake), with "
        f"{ACTION_SPACE} (steer, accelerate), or with discrete actions and --actions"
    )


def _table(file: Path, number: int) -> NDArray[np.float32]:
    """Return the controls of each discrete action."""
    try:
        rows = np.array(json.loads(file.read_text("utf-8")), np.float32)
    except OSError as error:
        raise TrainingError(f"--actions: {file} cannot be read ({error.strerror}); name another") from error
    except (ValueError, TypeError) as error:
        raise TrainingError(f"--actions: {file} is not as it should be ({error}); name {_TABLE}") from error
    if rows.ndim != 2 or rows.shape[0] != number or rows.shape[1] not in {2, 3}:
        raise TrainingError(f"--actions: {file} has shape {rows.shape}, and the policy {number} actions; name {_TABLE}")
    limits = ACTION_SPACE if rows.shape[1] == 2 else action_space()
    for row in rows:
        if not limits.contains(row):
            raise TrainingError(
                f"--actions: {row.tolist()} is out of range; steer and accelerate go from -1 to 1, "
                "throttle and brake from 0 to 1"
            )
    return rows
