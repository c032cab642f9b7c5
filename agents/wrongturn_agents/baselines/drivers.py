"""The five baselines: rule drivers that differ in what they choose at a junction, and a parked car."""

import math
from typing import Any, ClassVar, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.baselines.path import from_place
from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import DIRECTIONS, Action, AgentKind, Command, Track
from wrongturn_protocol.observations import Observation


class Careful(RuleDriver):
    """Obeys when the commanded exit exists, else stops before the junction.

    The command arrives 10 to 20 m before the stop line. Until then the car is slow enough to stop.
    """

    name: ClassVar[str] = "careful"

    def choose(self, view: View) -> Command | None:
        """Return the commanded exit if it exists, else None."""
        return view.command if view.command in view.exits else None


class AlwaysStops(RuleDriver):
    """Stops before every junction; shows that being safe without driving earns no rank."""

    name: ClassVar[str] = "always-stops"

    def choose(self, view: View) -> Command | None:  # noqa: ARG002
        """Return None, whatever the car sees."""
        return None


class IgnoresCommands(RuleDriver):
    """Takes an exit that exists, whatever the command; shows that ignoring commands earns no rank."""

    name: ClassVar[str] = "ignores-commands"

    def choose(self, view: View) -> Command | None:
        """Return the first exit that exists, in the order left, right, straight."""
        return next(iter(view.exits), None)


_RADII: Final = {Command.LEFT: 10.0, Command.RIGHT: 6.0}  # metres, as of the towns' usual turns
_RUN_OUT: Final = 60.0  # metres of a made-up path after its turn


class ObeysBlindly(RuleDriver):
    """Follows every command, even off the road; shows what wrong commands do to blind obedience."""

    name: ClassVar[str] = "obeys-blindly"

    def choose(self, view: View) -> Command | None:
        """Return the commanded direction; straight on if the command names none."""
        return view.command if view.command in DIRECTIONS else Command.STRAIGHT

    def path_beyond(self, view: View, direction: Command) -> NDArray[np.floating]:
        """Return the exit's path; if that exit does not exist, a quarter turn from the stop line or a straight path."""
        exit_path = view.exits.get(direction)
        return made_up_path(view, direction) if exit_path is None else exit_path


def made_up_path(view: View, direction: Command) -> NDArray[np.float64]:
    """Return (N, 2) points from the stop line in a direction, as if an exit were there."""
    end = np.asarray(view.lane[-1], np.float64)
    heading = _heading_at_end(view)
    if direction not in _RADII:
        return from_place(end, heading, np.array((0.0, _RUN_OUT)), np.zeros(2))
    radius, side = _RADII[direction], 1.0 if direction is Command.LEFT else -1.0
    turned = np.linspace(0.0, math.pi / 2.0, 12)
    forward, aside = radius * np.sin(turned), side * radius * (1.0 - np.cos(turned))
    forward, aside = np.append(forward, forward[-1]), np.append(aside, aside[-1] + side * _RUN_OUT)
    return from_place(end, heading, forward, aside)


def _heading_at_end(view: View) -> float:
    """Return the lane's heading at its stop line, in radians."""
    away = np.flatnonzero(np.hypot(*(view.lane - view.lane[-1]).T) > 1.5)
    if not len(away):  # at the line the rest of the lane is a point; the car's heading is the lane's
        return view.yaw
    dx, dy = (view.lane[-1] - view.lane[away[-1]]).tolist()
    return math.atan2(dy, dx)


class Parked:
    """Brakes at once and stands; shows that standing still earns no rank."""

    name: ClassVar[str] = "parked"
    track: ClassVar[Track] = Track.PRIVILEGED
    kind: ClassVar[AgentKind] = AgentKind.BASELINE

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Do nothing, because there is nothing to forget."""

    def act(self, observation: Observation) -> Action:  # noqa: ARG002
        """Return full brake."""
        return Action(steer=0.0, throttle=0.0, brake=1.0)
