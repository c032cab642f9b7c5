"""An agent that is driven by sentences: a small file that understands them, and ``lbc``, which drives.

The file learned by imitation which of the driving agent's answers a sentence asks for (``python -m lab.words``).
"""

from typing import Any, Final

import numpy as np
from gymnasium import spaces

from wrongturn_agents.onnx_agent import OnnxAgent, open_session
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS, WEIGHTS
from wrongturn_protocol import ActionLike, AgentKind, Track
from wrongturn_protocol.observations import Observation

FILE: Final = WEIGHTS / "lbc-words.sentence.onnx"
"""Understands sentences: ``sentence`` (1, 160) uint8 to ``command`` (1, 1) int64."""


class LbcWords:
    """Drives as lbc, told what to do by sentences, which it learned by imitation."""

    name = "lbc-words"
    track = Track.WORDS
    kind = AgentKind.REFERENCE
    memoryless = False

    def __init__(self) -> None:
        self._sentences: Any = open_session(FILE)
        self._driving = OnnxAgent(SHIPPED_AGENTS["lbc"].file)

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Forget the last episode."""
        self._driving.reset(observation_space)

    def act(self, observation: Observation) -> ActionLike:
        """Return the driving agent's action under the command that the sentence is taken for."""
        (command,) = self._sentences.run(["command"], {"sentence": np.asarray(observation["sentence"])[None]})
        return self._driving.act({**observation, "command": command[0]})
