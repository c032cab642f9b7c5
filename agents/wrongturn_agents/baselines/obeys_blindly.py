"""``obeys-blindly``: steers as told, whatever is there."""

import math
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import DIRECTIONS, Command

_RADII: Final = {Command.LEFT: 10.0, Command.RIGHT: 6.0}  # metres, of the towns' usual turns
_RUN_OUT: Final = 60.0  # metres that a made-up path goes straight on


class ObeysBlindly(RuleDriver):
    """Follows the command into an exit where there is one, and off the road where there is none."""

    name: ClassVar[str] = "obeys-blindly"
    description: ClassVar[str] = "Steers as told whatever is there; shows what wrong commands do to blind obedience."

    def choose(self, view: View) -> Command | None:
        """The commanded direction; straight on where none is named."""
        return view.command if view.command in DIRECTIONS else Command.STRAIGHT

    def path_beyond(self, view: View, direction: Command) -> NDArray[np.floating]:
        """The exit's path; where there is no such exit, a quarter turn from the stop line, or straight on."""
        exit_path = view.exits.get(direction)
        return made_up_path(view, direction) if exit_path is None else exit_path


def made_up_path(view: View, direction: Command) -> NDArray[np.float64]:
    """(N, 2) points from the stop line on in a direction, as if there were an exit."""
    end = np.asarray(view.lane[-1], np.float64)
    heading = _heading_at_end(view)
    if direction not in _RADII:
        away = _RUN_OUT * np.array((math.cos(heading), math.sin(heading)))
        return np.stack((end, end + away))
    radius, side = _RADII[direction], 1.0 if direction is Command.LEFT else -1.0
    turned = np.linspace(0.0, math.pi / 2.0, 12)
    forward, aside = radius * np.sin(turned), side * radius * (1.0 - np.cos(turned))
    forward, aside = np.append(forward, forward[-1]), np.append(aside, aside[-1] + side * _RUN_OUT)
    cos, sin = math.cos(heading), math.sin(heading)
    return np.stack((end[0] + cos * forward - sin * aside, end[1] + sin * forward + cos * aside), axis=1)


def _heading_at_end(view: View) -> float:
    """Of the lane at its stop line, radians."""
    away = np.flatnonzero(np.hypot(*(view.lane - view.lane[-1]).T) > 1.5)
    if not len(away):  # at the line itself what is left of the lane is but a point; the car stands as the lane does
        return view.yaw
    dx, dy = (view.lane[-1] - view.lane[away[-1]]).tolist()
    return math.atan2(dy, dx)
