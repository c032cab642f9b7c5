"""Drives that no verdict ends: a car alone, in process."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely import Point

from wrongturn_agents.agent import Agent, track_of_agent
from wrongturn_judge.trajectory import Trajectory
from wrongturn_networks import town_of
from wrongturn_protocol import Track, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.fleet.vector_env import WrongturnVectorEnv

LONGEST: Final = 62.0
"""Seconds of a drive: longer than any episode, so that a picture shows what follows a verdict."""
GONE: Final = 80.0
"""A car that was in the junction and is now this far from it is gone, metres."""

Actions = NDArray[np.float32]
"""Steer, throttle and brake of each decision, (n, 3)."""


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive: its actions decide everything else."""

    driver: str
    trial: Trial
    actions: Actions

    @property
    def trajectory(self) -> Trajectory:
        """The rows, from the actions."""
        env = _lone_car(self.trial, Track.STATE)
        env.reset(options={"trial": self.trial})
        for action in self.actions:
            env.step(action[None])
        return env.episode(0).trajectory


_CARS: dict[tuple[str, int | None, Track], WrongturnVectorEnv] = {}


def _lone_car(trial: Trial, track: Track) -> WrongturnVectorEnv:
    place = trial.town, trial.scenery, track
    if place not in _CARS:
        _CARS[place] = WrongturnVectorEnv(1, track=track, trial=trial, drive_on=LONGEST, autoreset_mode="Disabled")
    return _CARS[place]


def drive(driver: str, agent: Agent, trial: Trial) -> Drive:
    """Drive a trial for 62 s, or until the car has left the junction and is far away."""
    track = track_of_agent(agent)
    assert track is not None
    env = _lone_car(trial, track)
    seen, _ = env.reset(options={"trial": trial})
    agent.reset(observation_space(track))
    actions, over = [], False
    while not over:
        action = agent.act({name: array[0] for name, array in seen.items()})
        actions.append(np.array((action.steer, action.throttle, action.brake), np.float32))
        seen, _, ended, truncated, _ = env.step(actions[-1][None])
        over = bool(ended[0] or truncated[0])
    return Drive(driver, trial, np.array(actions[: _gone_after(env.episode(0).trajectory)]))


def _gone_after(trajectory: Trajectory) -> int | None:
    """Return the number of decisions after which the car is gone; None if it never is."""
    town = town_of(trajectory.trial)
    junction = town.junctions[town.approach(trajectory.trial.approach).junction]
    entered = False
    for decision, row in enumerate(trajectory.rows[::SUB_STEPS]):
        entered = entered or junction.area.contains(Point(row.x, row.y))
        if entered and math.dist((row.x, row.y), junction.position) > GONE:
            return decision
    return None
