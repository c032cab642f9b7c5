"""Agents that question their command: a small file that doubts, and a trained agent that drives behind it.

The file sees what the trained agent sees. From the picture it tells how far the next junction is and which exits it
has, and hands on a command that the road offers. A compensation makes up for wheels that turn too much or too little,
and for a late view. ``docs/doubting.md`` says how. ``wrongturn export`` writes all of it as one ONNX file.
"""

from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.compensation import MEMORY, compensated
from wrongturn_agents.onnx_agent import OnnxAgent
from wrongturn_protocol import Action, ActionLike, Track
from wrongturn_protocol.model_contract import DOUBT, STATE_IN, STATE_OUT
from wrongturn_protocol.observations import Observation

OBEYED: Final = "obeyed_command"
"""Output of the file that doubts: the command that the driving agent gets, int64 (1, 1)."""


class DoubtingAgent:
    """Agent that questions its command by a file, an ``onnxruntime.InferenceSession``, and lets another agent drive."""

    trained_on_faults = True
    memoryless = False

    def __init__(self, doubt: Any, driving: OnnxAgent) -> None:
        self._doubt = doubt
        self.driving = driving
        """The agent that drives."""
        said: dict[str, str] = doubt.get_modelmeta().custom_metadata_map
        self.name: str = said["name"]
        self.track: Track = driving.track
        shapes = {put.name: put.shape for put in doubt.get_inputs()}
        self._inputs = tuple(name for name in shapes if name != STATE_IN)
        self._nothing: NDArray[np.float32] = np.zeros((1, *shapes[STATE_IN][1:]), np.float32)
        self._memory = self._nothing
        self._compensation: NDArray[np.float32] = np.zeros((1, MEMORY), np.float32)
        self.obeyed: int | None = None
        """Number of the command that the driving agent got at the last step; None before the first."""
        self.doubt: float | None = None
        """Probability that the last command was wrong, as :attr:`OnnxAgent.doubt`."""

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Forget the last episode."""
        self._memory, self.obeyed, self.doubt = self._nothing, None, None
        self._compensation = np.zeros_like(self._compensation)
        self.driving.reset(observation_space)

    def act(self, observation: Observation) -> ActionLike:
        """Return the driving agent's action under the command that the road offers, as the car needs it."""
        return self.drive(observation, self.question(observation))

    def drive(self, observation: Observation, command: NDArray[np.int64]) -> Action:
        """Return the driving agent's action under a command, (1,), as the car needs it."""
        asked: Any = self.driving.act({**observation, "command": command})
        action, self._compensation = compensated(
            np,
            np.array([[asked.steer, asked.throttle, asked.brake]], np.float32),
            np.asarray(observation["steering"])[None],
            np.asarray(observation["speed"])[None],
            self._compensation,
        )
        return Action(*action[0].tolist())

    def question(self, observation: Observation) -> NDArray[np.int64]:
        """Return the command that the road offers, (1,), and remember the doubt."""
        feed = {name: np.asarray(observation[name])[None] for name in self._inputs}
        command, self._memory, doubt = self._doubt.run([OBEYED, STATE_OUT, DOUBT], {**feed, STATE_IN: self._memory})
        self.obeyed, self.doubt = int(command[0, 0]), float(doubt[0, 0])
        found: NDArray[np.int64] = command[0]
        return found
