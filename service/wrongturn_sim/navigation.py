"""What a planner tells a model besides the command: next command, distance, target points, sentence.

All of them follow what the trial's fault delivers, so that one fault changes them in the same way.

The *commanded way* leads along the lane to its stop line. From there it is constructed, whether or not the junction has
the commanded exit: a quarter of a circle to the left or right, or straight on, and then a straight line. So its points
tell nothing of the junction's exits, as a model is told nothing of them by a command. ``docs/rigs.md`` shows it.
"""

import math
import random
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_faults import sentence
from wrongturn_faults.rules import Guidance
from wrongturn_networks.faults import CommandFault
from wrongturn_protocol import DIRECTIONS, Command, NavigationInput, Rig, Track, Trial
from wrongturn_protocol.observations import Observation, sentence_of
from wrongturn_sim.ego import State
from wrongturn_sim.route import Navigator

RADII: Final = {Command.LEFT: 15.5, Command.RIGHT: 11.5}
"""Radii of the constructed turns, metres: medians of the turns of Town01 and Town02."""
ACROSS: Final = 27.0
"""Length of the constructed way straight on through a junction, metres."""
_NEAREST: Final = 7.5
"""Target points lie farther ahead than this along the way, metres, as TransFuser's planner has it."""
_APART: Final = 20.0
"""Distance between target points on a lane, metres."""
_POINTS: Final = 2


class Planner:
    """Tells the navigation inputs of one episode, one decision after the other."""

    def __init__(self, sight: Track | Rig, trial: Trial, fault: CommandFault, navigator: Navigator) -> None:
        rig = sight if isinstance(sight, Rig) else Rig(navigation=(NavigationInput.SENTENCE,))  # the track words
        self._inputs = rig.navigation
        drawn = random.Random(f"sentence {trial.seed}")
        self._kind = drawn.choice(rig.sentences)
        self._number = drawn.randrange(1 << 16)
        self._alone = NavigationInput.COMMAND not in self._inputs
        self._fault, self._navigator = fault, navigator

    def told(self, t: float, guidance: Guidance, command: Command, state: State) -> Observation:
        """Return the inputs after the command that is delivered, as new arrays."""
        beside = self._fault.beside(t, guidance)
        if beside == self._fault.deliver(t, guidance):
            beside = command  # also that of a fork
        found: Observation = {}
        for name in self._inputs:
            if name is NavigationInput.COMMAND:
                found[name.value] = np.array([command], np.int64)
            elif name is NavigationInput.NEXT_COMMAND:
                found[name.value] = np.array([self._after(t, guidance, command)], np.int64)
            elif name is NavigationInput.DISTANCE:
                found[name.value] = np.array([self._distance(guidance)], np.float32)
            elif name is NavigationInput.TARGET_POINTS:
                direction = beside if beside in DIRECTIONS else self._after(t, guidance, beside)
                found[name.value] = self._points(direction, self._fault.shift(guidance), state)
            else:
                both = self._alone and beside is not command
                found[name.value] = sentence_of(
                    " ".join(self._said(one, guidance) for one in ((command, beside) if both else (beside,)))
                )
        return found

    def _after(self, t: float, guidance: Guidance, command: Command) -> Command:
        """Return the command that follows the present one: at the next stop line, unless it is told now."""
        ahead = guidance.ahead
        if command in DIRECTIONS or ahead is None:
            return Command.LANE_FOLLOW
        shift = self._fault.shift(guidance)
        there = ahead._replace(to_line=-shift, to_exit=ahead.to_exit - ahead.to_line - shift)
        at_line = guidance._replace(command=ahead.route, ahead=there, last=None)
        return self._fault.beside(t, at_line)

    def _distance(self, guidance: Guidance) -> float:
        if guidance.ahead is None:
            return -1.0
        return max(guidance.ahead.to_line + self._fault.shift(guidance), 0.0)

    def _said(self, command: Command, guidance: Guidance) -> str:
        """Return the sentence of a command; one that its kind leaves unsaid is said plainly."""
        away = max(self._distance(guidance), 0.0)
        if self._kind == "ambiguous" and command in DIRECTIONS:
            command = Command.VOID
        kinds = (self._kind, "plain")
        said = (sentence(command, kind, number=self._number, distance=away) for kind in kinds)
        return next(filter(None, said), "")

    def _points(self, direction: Command, shift: float, state: State) -> NDArray[np.float32]:
        """Return the next two points of the commanded way, forward and left of the body's middle, (2, 2)."""
        lane, s = self._navigator.line_and_place()
        end = lane.length + shift
        if s > end:  # where the car is on the constructed way, not on the route's
            way = [(past, *place_past(lane.at(end), past, direction)) for past in np.arange(0.0, 60.0, 0.5).tolist()]
            s = end + min(way, key=lambda one: math.hypot(one[1] - state[0], one[2] - state[1]))[0]
        turn = RADII.get(direction, 0.0) * math.pi / 2 or ACROSS
        plan = [end - _APART * k for k in range(int(end / _APART), -1, -1)]
        plan += [end + turn + _APART * k for k in range(6)]
        ahead = [place for place in plan if place > s + _NEAREST][:_POINTS]
        cos, sin = math.cos(state[2]), math.sin(state[2])
        found = np.empty((_POINTS, 2), np.float32)
        for row, place in enumerate(ahead):
            x, y = place_past(lane.at(min(place, end)), place - end, direction)
            found[row] = (x - state[0]) * cos + (y - state[1]) * sin, (y - state[1]) * cos - (x - state[0]) * sin
        return found


def place_past(line: tuple[float, float, float], past: float, direction: Command) -> tuple[float, float]:
    """Return the point of the constructed way so far past the stop line, which is a place and a heading."""
    x, y, heading = line
    if past <= 0.0:
        return x, y
    radius = RADII.get(direction)
    if radius is None:
        return x + past * math.cos(heading), y + past * math.sin(heading)
    side = 1.0 if direction is Command.LEFT else -1.0
    angle = min(past / radius, math.pi / 2)
    ahead, left = radius * math.sin(angle), side * radius * (1.0 - math.cos(angle))
    left += side * max(past - radius * math.pi / 2, 0.0)
    cos, sin = math.cos(heading), math.sin(heading)
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos
