"""Drives that no judge ends: a car alone, in process, with the service's own vehicle, route and faults."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely import Point

from wrongturn_agents.agent import Agent, track_of_agent
from wrongturn_networks import load_town
from wrongturn_protocol import Track, Trial
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_sim.camera import Renderer, World
from wrongturn_sim.ego import SUB_STEP, SUB_STEPS, State, advance
from wrongturn_sim.faults import make_fault
from wrongturn_sim.observation import observe_privileged, observe_state
from wrongturn_sim.route import Navigator, start_pose
from wrongturn_sim.trajectory import Row, Trajectory

LONGEST: Final = 62.0
"""Seconds of a drive: longer than any episode, so that a picture shows what follows a verdict."""
PER_SECOND: Final = round(1 / SUB_STEP)
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
        car = LoneCar(self.trial)
        for action in self.actions.tolist():
            car.step(*action)
        return car.trajectory


class LoneCar:
    """A car without other road users. Its rows have the same bytes as an episode's, and go on past its end."""

    def __init__(self, trial: Trial) -> None:
        self.town = load_town(trial.town)
        self.state: State = (*start_pose(self.town, trial), trial.start.speed, 0.0)
        self.trajectory = Trajectory(trial, self.town.sha256)
        self._navigator = Navigator(self.town, trial)
        self._fault = make_fault(trial)
        self._sub_steps = 0
        self._guide()
        start = Row(0.0, *self.state, int(self._command), int(self._guidance.command), 0.0, 0.0, 0.0)
        self.trajectory.append(start)

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return self._sub_steps / PER_SECOND

    def step(self, steer: float, throttle: float, brake: float) -> None:
        """Drive for 0.1 s; the action is rounded to float32 already."""
        commands = int(self._command), int(self._guidance.command)
        for _ in range(SUB_STEPS):
            self.state = advance(*self.state, steer, throttle, brake, SUB_STEP)
            self._sub_steps += 1
            self.trajectory.append(Row(self.seconds, *self.state, *commands, steer, throttle, brake))
        self._guide()

    def observe(self, track: Track, renderer: Renderer | None) -> Observation:
        """Return the observation of a track; one with pictures needs a renderer."""
        if renderer is None:
            return observe_privileged(self.state, self._command, self._navigator, ())
        observation = observe_state(self.state, self._command)
        observation["rgb"], segmentation = renderer.render(*self.state[:3], self._sub_steps // SUB_STEPS)
        if track is Track.SEGMENTATION:
            observation["segmentation"] = segmentation
        return observation

    def _guide(self) -> None:
        self._guidance = self._navigator.update(self.state[0], self.state[1])
        self._command = self._fault.deliver(self.seconds, self._guidance)


def drive(driver: str, agent: Agent, trial: Trial) -> Drive:
    """Drive a trial for 62 s, or until the car has left the junction and is far away."""
    track = track_of_agent(agent)
    assert track is not None
    car = LoneCar(trial)
    world = World.of(car.town)
    renderer = None if track is Track.PRIVILEGED else Renderer(world, weather=trial.weather, seed=trial.seed)
    junction = car.town.junctions[car.town.approach(trial.approach).junction]
    agent.reset(observation_space(track))
    actions, entered, away = [], False, 0.0
    while car.seconds < LONGEST and not (entered and away > GONE):
        action = agent.act(car.observe(track, renderer))
        numbers = np.array((action.steer, action.throttle, action.brake), np.float32)
        actions.append(numbers)
        car.step(*numbers.tolist())
        away = math.dist(car.state[:2], junction.position)
        entered = entered or junction.area.contains(Point(*car.state[:2]))
    return Drive(driver, trial, np.array(actions))
