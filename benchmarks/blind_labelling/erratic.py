"""Drivers that produce the hard cases of version 2. Each drive has its own script, drawn from a seed."""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wrongturn_agents.baselines import Manner, Path, RuleDriver, View
from wrongturn_agents.baselines.drivers import made_up_path
from wrongturn_protocol import DIRECTIONS, Action, Command
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.vehicle import DECISION_S, VEHICLE

RADIUS, OPPOSED = 4.5, 4.0
"""Radius of a U-turn, and distance of the opposed lane's middle from the lane's, metres."""
ARRIVED = 0.25
"""A car this far before a place is there, metres."""


@dataclass(frozen=True)
class Pause:
    """A place where the car stands or creeps."""

    place: float
    """Metres past the stop line, along the path; negative before it."""
    seconds: float
    speed: float = 0.0
    """Speed meanwhile, m/s."""


@dataclass(frozen=True)
class Script:
    """What a drive does."""

    blind: bool
    """Obey a command whose exit does not exist. Otherwise the car takes one that exists."""
    pauses: tuple[Pause, ...] = ()
    """In the order of their places."""
    aside: tuple[tuple[float, float], ...] = ()
    """Metres past the stop line, and metres that the path is moved to the left there; straight lines in between."""
    turn_round: tuple[float, float] | None = None
    """Turn round this far past the stop line, after a swing to the right by so much, metres; None does not."""
    cruise: float = 8.0
    """Speed on an open street, m/s."""


class Erratic(RuleDriver):
    """Follows a script."""

    def __init__(self, script: Script) -> None:
        super().__init__(manner=Manner(cruise=script.cruise))
        self.script = script
        self._left = list(script.pauses)
        self._decisions = 0

    def choose(self, view: View) -> Command | None:
        """Return the commanded direction, or one that exists."""
        if view.command in view.exits or (self.script.blind and view.command in DIRECTIONS):
            return view.command
        return self._choice or (Command.STRAIGHT if self.script.blind else next(iter(view.exits), None))

    def path_beyond(self, view: View, direction: Command) -> NDArray[np.floating]:
        """Return a U-turn, the exit's path, or a path as if there were an exit."""
        if self.script.turn_round is not None:
            return u_turn(view, *self.script.turn_round)
        known = view.exits.get(direction)
        return made_up_path(view, direction) if known is None else known

    def act(self, observation: Observation) -> Action:
        """Return the action of the script."""
        view = View.of(observation)
        before = self._path
        kept = self._path if self.script.turn_round and self._choice is not None else None
        path = kept or self._plan(view)[0]
        if self._path is not before and self._path is not None and self._line is not None:
            path = self._path = moved_aside(path, self._line, self.script.aside)
        wanted = self._acceleration(view, path, path.project(view.x, view.y), None)
        if self._line is not None and self._left:
            wanted = min(wanted, self._paused(view, path.project(view.x, view.y) - self._line))
        return Action(
            steer=min(max(self._steer(view, path), -1.0), 1.0),
            throttle=min(max(wanted / VEHICLE.acceleration, 0.0), 1.0),
            brake=min(max(-wanted / VEHICLE.braking, 0.0), 1.0),
        )

    def _paused(self, view: View, past: float) -> float:
        """Return the greatest acceleration that the next pause allows, m/s2."""
        pause = self._left[0]
        slow = math.sqrt(pause.speed**2 + 2.0 * self.manner.braking * max(0.0, pause.place - past))
        if past < pause.place - ARRIVED and slow > 0.3:
            return self.manner.gain * (slow - view.speed)
        self._decisions += 1
        if self._decisions * DECISION_S > pause.seconds:
            self._left.pop(0)
            self._decisions = 0
        if pause.speed == 0.0:
            return -VEHICLE.braking if view.speed < 1.0 else -self.manner.hard_braking
        return self.manner.gain * (pause.speed - view.speed) + 0.15  # the car's drag


def hesitant(seed: str) -> Erratic:
    """Return a driver that pauses for 3 to 12 s before or in the junction, or creeps, and then goes on."""
    numbers = random.Random(seed)
    kind = numbers.choice(("before", "before", "inside", "inside", "often", "creep", "creep inside"))
    if kind == "before":
        pauses = [
            Pause(numbers.uniform(-16.0, -2.5), numbers.uniform(3.0, 14.0)) for _ in range(numbers.choice((1, 2)))
        ]
    elif kind == "inside":
        pauses = [
            Pause(numbers.uniform(0.5, 11.0), numbers.uniform(1.5, 5.0)) for _ in range(numbers.choice((1, 2, 3)))
        ]
    elif kind == "often":
        pauses = [
            Pause(numbers.uniform(0.5, 12.0), numbers.uniform(1.0, 2.9)) for _ in range(numbers.choice((3, 4, 6)))
        ]
    else:
        first = 0.0 if kind == "creep inside" else -14.0
        pauses = [Pause(numbers.uniform(first, first + 11.0), numbers.uniform(4.0, 22.0), numbers.uniform(0.02, 0.5))]
    pauses.sort(key=lambda pause: pause.place)
    return Erratic(Script(numbers.random() < 0.6, tuple(pauses), cruise=numbers.uniform(5.0, 9.0)))


def astray(seed: str) -> Erratic:
    """Return a driver that enters oncoming lanes, turns round, stops over the line, or bites kerbs."""
    numbers = random.Random(seed)
    kind = numbers.choice(("before", "after", "after", "stays", "round", "line", "kerb", "kerb"))
    blind, cruise = numbers.random() < 0.3, numbers.uniform(5.0, 8.0)
    if kind == "line":
        stay = Pause(numbers.uniform(-2.6, 1.2), numbers.choice((6.0, 9.0, 11.0, 14.0, 60.0)))
        return Erratic(Script(blind, (stay,), cruise=cruise))
    if kind == "round":
        where = numbers.uniform(6.0, 14.0), numbers.uniform(0.5, 4.0)
        return Erratic(Script(False, turn_round=where, cruise=numbers.uniform(2.5, 4.0)))
    if kind == "kerb":
        bite, at = -numbers.uniform(0.7, 2.3), numbers.uniform(-12.0, 12.0)
        aside = ((at - 7.0, 0.0), (at, bite), (at + numbers.uniform(2.0, 12.0), bite), (at + 22.0, 0.0))
        return Erratic(Script(False, aside=aside, cruise=cruise))
    over, length = numbers.uniform(2.5, 4.2), numbers.uniform(3.0, 25.0)
    at = numbers.uniform(-24.0, -14.0) if kind == "before" else numbers.uniform(4.0, 18.0)
    aside = ((at, 0.0), (at + 7.0, over), (at + 7.0 + length, over), (at + 14.0 + length, 0.0))
    if kind == "stays":
        stay = Pause(at + numbers.uniform(6.0, 25.0), numbers.choice((12.0, 60.0)))
        return Erratic(Script(False, (stay,), aside[:2], cruise=cruise))
    return Erratic(Script(blind, aside=aside, cruise=cruise))


def awkward(seed: str) -> Erratic:
    """Return a driver that plays with time limits and oncoming lanes: most of what only version 2 of the judge sees."""
    numbers = random.Random(seed)
    kind = numbers.choice(("stays", "stays", "crosses", "slow", "slow", "creeps", "waits", "round", "beside", "area"))
    cruise, at = numbers.uniform(5.0, 7.0), numbers.uniform(6.0, 18.0)
    oncoming = numbers.uniform(3.4, 4.2)
    match kind:
        case "stays":
            stay = Pause(at + numbers.uniform(8.0, 34.0), 60.0)
            script = Script(False, (stay,), ((at, 0.0), (at + 7.0, oncoming)), cruise=cruise)
        case "crosses":
            length = numbers.uniform(1.0, 9.0)
            back = ((at + 7.0 + length, oncoming), (at + 14.0 + length, 0.0))
            script = Script(False, aside=((at, 0.0), (at + 7.0, oncoming), *back), cruise=cruise)
        case "slow":
            script = Script(False, cruise=numbers.uniform(0.55, 1.4))
        case "creeps":
            creep = Pause(numbers.uniform(-17.0, -6.0), 60.0, numbers.uniform(0.03, 0.09))
            script = Script(False, (creep,), cruise=cruise)
        case "waits":
            places = np.arange(-16.0, -3.0, numbers.uniform(1.2, 2.5)).tolist()
            script = Script(False, tuple(Pause(place, numbers.uniform(6.0, 9.3)) for place in places), cruise=cruise)
        case "round":
            where = numbers.uniform(7.0, 13.0), numbers.uniform(2.0, 4.0)
            stay = (Pause(numbers.uniform(20.0, 55.0), 60.0),) if numbers.random() < 0.5 else ()
            script = Script(False, stay, turn_round=where, cruise=numbers.uniform(2.0, 3.5))
        case "beside":
            begin = numbers.uniform(-24.0, -14.0)
            stay = Pause(numbers.uniform(-6.0, 0.5), 60.0)
            script = Script(False, (stay,), ((begin, 0.0), (begin + 7.0, oncoming)), cruise=cruise)
        case _:
            creep = Pause(numbers.uniform(0.0, 4.0), numbers.uniform(12.0, 19.0), numbers.uniform(0.13, 0.3))
            script = Script(numbers.random() < 0.3, (creep,), cruise=cruise)
    return Erratic(script)


def u_turn(view: View, ahead: float, swing: float) -> NDArray[np.float64]:
    """Return (N, 2) points from the stop line: some metres on and to the right, a half circle to the left, and back."""
    end = np.asarray(view.lane[-1], np.float64)
    away = next(point for point in reversed(view.lane) if math.dist(point, end) > 1.5)
    heading = math.atan2(*(end - away)[::-1])
    angles = np.linspace(-math.pi / 2, math.pi / 2, 16)
    forward = np.concatenate(([0.0], ahead + RADIUS * np.cos(angles), [ahead - 7.0, -60.0]))
    left = np.concatenate(([0.0], RADIUS * (1.0 + np.sin(angles)) - swing, [OPPOSED, OPPOSED]))
    cos, sin = math.cos(heading), math.sin(heading)
    return np.stack((end[0] + cos * forward - sin * left, end[1] + sin * forward + cos * left), axis=1)


def moved_aside(path: Path, line: float, aside: Sequence[tuple[float, float]]) -> Path:
    """Return a path moved to the left by metres that depend on the distance past the stop line."""
    if not aside:
        return path
    places = np.arange(0.0, path.distances[-1], 1.0)
    points = np.array([path.at(place) for place in places])
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-6)[:, None]
    past, metres = zip(*aside, strict=True)
    left = np.interp(places - line, past, metres)[:, None]
    return Path.through(points + left * np.stack((-along[:, 1], along[:, 0]), axis=1))
