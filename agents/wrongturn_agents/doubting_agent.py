"""The shipped agents that question their command: a small file that doubts, and a trained agent that drives behind it.

The file sees what the trained agent sees. From the picture it tells how far the next junction is and which exits it
has, and hands on a command that the road offers. ``docs/doubting.md`` says how. ``wrongturn export`` writes both as one
ONNX file.
"""

from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.onnx_agent import OnnxAgent, open_session
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS, WEIGHTS, load_shipped
from wrongturn_protocol import Action, AgentKind, Track
from wrongturn_protocol.model_contract import STATE_IN, STATE_OUT
from wrongturn_protocol.observations import Observation

OBEYED: Final = "obeyed_command"
"""Output of the file that doubts: the command that the driving agent gets, int64 (1, 1)."""


class DoubtingAgent:
    """Agent that hands a questioned command to another agent.

    Args:
        doubt: an ``onnxruntime.InferenceSession`` of the file that doubts.
        driving: the agent that drives.
    """

    trained_on_faults = True
    memoryless = False

    def __init__(self, doubt: Any, driving: OnnxAgent) -> None:
        self._doubt = doubt
        self._driving = driving
        said: dict[str, str] = doubt.get_modelmeta().custom_metadata_map
        self.name: str = said["name"]
        self.track: Track = driving.track
        shapes = {put.name: put.shape for put in doubt.get_inputs()}
        self._inputs = tuple(name for name in shapes if name != STATE_IN)
        self._nothing: NDArray[np.float32] = np.zeros((1, *shapes[STATE_IN][1:]), np.float32)
        self._memory = self._nothing
        self.obeyed: int | None = None
        """Number of the command that the driving agent got at the last step; None before the first."""

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Forget the last episode."""
        self._memory, self.obeyed = self._nothing, None
        self._driving.reset(observation_space)

    def act(self, observation: Observation) -> Action:
        """Return the driving agent's action under the command that the road offers."""
        feed = {name: np.asarray(observation[name])[None] for name in self._inputs}
        command, self._memory = self._doubt.run([OBEYED, STATE_OUT], {**feed, STATE_IN: self._memory})
        self.obeyed = int(command[0, 0])
        return self._driving.act({**observation, "command": command[0]})


@dataclass(frozen=True)
class ShippedDoubtingAgent:
    """A doubting agent of this project."""

    name: str
    drives: str
    """Name of the trained agent behind it."""
    description: str
    kind: AgentKind = AgentKind.REFERENCE
    trained_on_faults: bool = True

    @property
    def track(self) -> Track:
        """Track of the driving agent."""
        return SHIPPED_AGENTS[self.drives].track

    @property
    def file(self) -> Path:
        """Path of the file that doubts."""
        return WEIGHTS / f"{self.name}.gate.onnx"

    @property
    def files(self) -> tuple[Path, ...]:
        """Paths of the file that doubts and of the one that drives: another agent drives if one of them changes."""
        return self.file, SHIPPED_AGENTS[self.drives].file

    @property
    def card(self) -> Path:
        """Path of the model card in Markdown."""
        return WEIGHTS / f"{self.name}.md"

    def make(self) -> DoubtingAgent:
        """Load the agent.

        Raises:
            ModelFileError: the weights are missing or broken, its own or those of the driving agent.
            OnnxRuntimeMissingError: onnxruntime is not installed.
        """
        # Copies share the loaded files, so many cars cost no more memory than one.
        return copy(load_shipped(self.name, self.file, lambda file: _loaded(file, self.drives)))


@lru_cache(maxsize=8)
def _loaded(file: Path, drives: str) -> DoubtingAgent:
    return DoubtingAgent(open_session(file), SHIPPED_AGENTS[drives].make())


DOUBTING_AGENTS: Final = MappingProxyType(
    {
        agent.name: agent
        for agent in (
            ShippedDoubtingAgent(
                "doubting",
                "ppo-image",
                "Drives as ppo-image, behind a gate that questions the command: by the picture it tells which exits "
                "the next junction has. Made for wrong commands.",
            ),
            ShippedDoubtingAgent(
                "doubting-segmentation",
                "ppo-segmentation",
                "Drives as ppo-segmentation, behind a gate that questions the command: by the segmentation it tells "
                "which exits the next junction has. Made for wrong commands.",
            ),
        )
    }
)
"""Doubting agents by name."""
