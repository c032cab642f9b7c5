"""Stand-in for a learned agent: it drives well, but sees the junction ahead through noise.

It has a score for each direction: whether an exit seems to be there, plus a bonus for the command and a smaller one for
going straight on. Noise that drifts from step to step disturbs what it sees. It takes the direction with the best
score, even if no exit is there, and stops if no score is high enough. Small noise disturbs its steering too.
"""

import random

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.baselines import RuleDriver, View
from wrongturn_agents.baselines.drivers import made_up_path
from wrongturn_protocol import DIRECTIONS, Action, Command
from wrongturn_protocol.observations import Observation

_OBEDIENCE = 2.2  # bonus for the commanded direction; an exit that is there counts 1, one that is not counts -1
_HABIT = 0.8  # bonus for straight on
_FOLLOWING = 0.7  # added to it if the command is to follow the lane
_DOUBT = 0.2  # score below which it stops
_NOISE = 0.8  # standard deviation of what it sees
_MEMORY = 0.93  # correlation of the noise from one step to the next
_TREMBLE = 0.06  # standard deviation of the steering


class NoisyDriver(RuleDriver):
    """Driver with a seed: the same seed and episodes in the same order give the same drives."""

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
