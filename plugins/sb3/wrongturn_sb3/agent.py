"""Agent that drives with what Stable-Baselines3's ``model.save`` wrote. It needs the extra ``training``.

The policy is the one that ``wrongturn export sb3`` would export: see ``docs/models.md``.
"""

import shlex
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces

from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.training.errors import TrainingError
from wrongturn_client.invocation import program
from wrongturn_protocol import Action, AgentKind
from wrongturn_protocol.observations import Observation
from wrongturn_sb3.spaces import DrivingPolicy


class Sb3Agent:
    """Agent whose actions are a policy's most likely ones. Making it runs code that the file names.

    Args:
        file: Zip file that ``model.save`` wrote.

    Raises:
        ModelFileError: The file is no such model, or its spaces are not those of Wrongturn's environments.
    """

    def __init__(self, file: Path) -> None:
        try:
            self._driving = DrivingPolicy(file)
        except TrainingError as error:
            raise ModelFileError(f"agent: {_in_a_run(file, str(error))}") from error
        # Several episodes run side by side, and threads inside a step would only wait for each other.
        torch.set_num_threads(1)
        self.track = self._driving.track
        self.name = file.stem
        self.kind = AgentKind.SUBMITTED
        self.description = f"Learned by {self._driving.algorithm} of Stable-Baselines3."
        self.trained_on_faults = False
        self.memoryless = True

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Do nothing: the policy keeps no memory."""

    def act(self, observation: Observation) -> Action:
        """Return the policy's deterministic action."""
        steer, throttle, brake = map(float, self._driving.controls(observation))
        return Action(steer=steer, throttle=throttle, brake=brake)

    def act_batch(self, observations: Observation) -> list[Action]:
        """Return the policy's action for each row of the observations, one by one: torch rounds batches differently."""
        rows = len(observations["speed"])
        return [self.act({key: array[row] for key, array in observations.items()}) for row in range(rows)]


def _in_a_run(file: Path, said: str) -> str:
    """Return an error of the export with the remedy of a run, which has none of the export's options."""
    if not said.startswith("--"):
        return said
    exported = shlex.quote(f"{file.stem}.onnx")
    return (
        f"{file}: it needs more than the file: {said}. Export it with that option: '{program()} export sb3 "
        f"{shlex.quote(str(file))} --out {exported} …', then '{program()} run {exported}'"
    )
