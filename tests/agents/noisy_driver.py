"""A stand-in for a learned agent: it drives well, and sees the junction ahead through noise.

For each direction it holds a score: whether an exit seems to be there, pulled by the command and, weaker, by the habit
of going straight on. What it sees is disturbed by noise that wanders from step to step. It takes the best direction,
made up where there is nothing, and hesitates where none convinces it. Its hands tremble a little.
"""

import random

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.baselines import RuleDriver, View
from wrongturn_agents.baselines.obeys_blindly import made_up_path
from wrongturn_protocol import DIRECTIONS, Action, Command
from wrongturn_protocol.observations import Observation

_OBEDIENCE = 2.2  # pull of the command, where an exit that is there weighs 1 and one that is not -1
_HABIT = 0.8  # pull of straight on
_FOLLOWING = 0.7  # more of it where the command is to follow the lane
_DOUBT = 0.2  # score below which it rather stops
_NOISE = 0.8  # standard deviation of what it sees
_MEMORY = 0.93  # of the noise from one step to the next
_TREMBLE = 0.06  # standard deviation of the steering


class NoisyDriver(RuleDriver):
    """Seeded: the same seed and the same episodes in the same order give the same drives."""

    name = "noisy"

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._random = random.Random(f"noisy driver {seed}")
        self._noise = dict.fromkeys(DIRECTIONS, 0.0)
        self._tremor = 0.0

    def reset(self, observation_space: spaces.Space) -> None:
        super().reset(observation_space)
        self._noise = {direction: self._random.gauss(0.0, _NOISE) for direction in DIRECTIONS}
        self._tremor = 0.0

    def act(self, observation: Observation) -> Action:
        fresh = (1.0 - _MEMORY**2) ** 0.5
        for direction in DIRECTIONS:
            wander = self._random.gauss(0.0, fresh * _NOISE)
            self._noise[direction] = _MEMORY * self._noise[direction] + wander
        self._tremor = 0.8 * self._tremor + self._random.gauss(0.0, 0.6 * _TREMBLE)
        action = super().act(observation)
        return action.model_copy(update={"steer": min(max(action.steer + self._tremor, -1.0), 1.0)})

    def choose(self, view: View) -> Command | None:
        habit = _HABIT + (_FOLLOWING if view.command is Command.LANE_FOLLOW else 0.0)
        scores = {
            direction: (1.0 if direction in view.exits else -1.0)
            + (_OBEDIENCE if direction is view.command else 0.0)
            + (habit if direction is Command.STRAIGHT else 0.0)
            + self._noise[direction]
            for direction in DIRECTIONS
        }
        best = max(scores, key=lambda direction: scores[direction])
        return best if scores[best] > _DOUBT else None

    def path_beyond(self, view: View, direction: Command) -> NDArray[np.floating]:
        exit_path = view.exits.get(direction)
        return made_up_path(view, direction) if exit_path is None else exit_path
