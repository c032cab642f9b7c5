"""Agents without a memory: what they do depends on what they see alone, so that another process can go on with it."""

from typing import Any

import numpy as np

from wrongturn_agents.baselines import Careful, ObeysBlindly
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Action


class Forgetful:
    """A baseline that is made anew for each decision; beyond the stop line it finds its exit by what is in sight."""

    def __init__(self, kind: type[Careful] | type[ObeysBlindly]) -> None:
        self._kind = kind

    def reset(self, _space: Any) -> None: ...

    def act(self, observation: Any) -> Action:
        view = View.of(observation)
        if view.exits and not view.near_junction:
            if view.command not in view.exits:
                return Action(steer=0.0, throttle=0.5, brake=0.0)
            # As if the exit's path were the lane.
            nothing = np.zeros_like(observation["exits_mask"])
            observation = {**observation, "lane": view.exits[view.command], "exits_mask": nothing}
        return self._kind().act(observation)


POLICIES = {"careful": Careful, "obeys-blindly": ObeysBlindly}


def policy(name: str) -> Forgetful:
    """By a baseline's name."""
    return Forgetful(POLICIES[name])
