"""The bridge to SUMO, and the only file that imports libsumo.

libsumo holds one simulation per process: a second ``start()`` silently kills the first. :class:`_Process` knows which
episode holds it. The episode that begins last takes it; the one before gets SimulatorInUseError at its next step.
"""

import math
import weakref
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Final

from wrongturn_protocol import VEHICLE
from wrongturn_sim.ego import SUB_STEP
from wrongturn_sim.errors import SimulatorFailedError, SimulatorInUseError, SimulatorUnavailableError
from wrongturn_sim.simulation import Simulation
from wrongturn_sim.traffic.crowd import Crowd
from wrongturn_sim.traffic.plan import TrafficPlan

EGO: Final = "ego"
EGO_TYPE: Final = "wrongturn-ego"
KEEP_ROUTE: Final = 2
"""Mode of ``moveToXY``: put the car exactly there, on the road or off it."""
DEBIAN_PACKAGES: Final = ("libx11-6", "libxext6", "libxrender1", "libgl1", "libatomic1")
"""Packages with the libraries that libsumo needs; slim images lack them."""

_OPTIONS: Final = (
    *("--step-length", str(SUB_STEP)),
    *("--no-step-log", "true"),
    *("--no-warnings", "true"),
    *("--duration-log.disable", "true"),
    *("--collision.action", "none"),  # SUMO's collisions are wrong for a car that is moved from outside
    *("--time-to-teleport", "-1"),
    *("--time-to-teleport.highways", "-1"),
    *("--xml-validation", "never"),
    *("--xml-validation.net", "never"),
)
_WITH_TRAFFIC: Final = ("--insertion-checks", "collision")
"""A car enters as soon as it overlaps no other, even if another has to brake; else cars in a jam would enter late."""
_HALF_LENGTH: Final = VEHICLE.half_length
_DEGREES: Final = 180.0 / math.pi
_SETTLING: Final = 10


def _nobody() -> None:
    """Stand for the reference to a simulation that has ended."""


class _Process:
    """What this process has loaded, and which episode drives in it."""

    sumo: ModuleType | None = None
    net: Path | None = None
    """The loaded net, if no traffic has driven in it; else None."""
    holder: Callable[[], Simulation | None] = staticmethod(_nobody)
    """Returns the simulation of the episode that drives now. It is a weak reference: an episode that nobody keeps
    holds nothing."""


def load_libsumo() -> ModuleType:
    """Import and return libsumo.

    Raises:
        SimulatorUnavailableError: libsumo or a library that it needs is missing.
    """
    if _Process.sumo is None:
        try:
            import libsumo  # noqa: PLC0415 - only driving needs it

            _Process.sumo = libsumo
        except ImportError as error:
            raise SimulatorUnavailableError(
                f"libsumo cannot be loaded ({error}); install the Debian packages {' '.join(DEBIAN_PACKAGES)} "
                "and `pip install libsumo`"
            ) from error
    return _Process.sumo


def _start(net: Path, seed: int, *more: str) -> ModuleType:
    """Load a net unless it is loaded already, and return libsumo."""
    sumo = load_libsumo()
    if _Process.net == net:
        return sumo
    _Process.net = None
    options = ["--net-file", str(net), "--seed", str(seed), *_OPTIONS, *more]
    try:
        if sumo.isLoaded():
            sumo.load(options)
        else:
            sumo.start(["sumo", *options])
        sumo.vehicletype.copy("DEFAULT_VEHTYPE", EGO_TYPE)
        sumo.vehicletype.setLength(EGO_TYPE, VEHICLE.length)
        sumo.vehicletype.setWidth(EGO_TYPE, VEHICLE.width)
        sumo.vehicletype.setMaxSpeed(EGO_TYPE, VEHICLE.max_speed)
    except Exception as error:
        raise SimulatorFailedError(f"SUMO cannot load {net.name}: {error}; is it a net of SUMO 1.28?") from error
    _Process.net = net
    return sumo


class _SumoSimulation(Simulation):
    """A simulation in this process's SUMO; it ends when another episode begins in it."""

    __slots__ = ("_crowd", "_move", "_step", "_sumo")

    def __init__(self, sumo: ModuleType, crowd: Crowd | None = None) -> None:
        super().__init__(crowd)
        self._sumo = sumo
        self._crowd = crowd
        self._move = sumo.vehicle.moveToXY
        self._step = sumo.simulationStep

    def move(self, x: float, y: float, yaw: float) -> None:
        if _Process.holder() is not self:
            raise SimulatorInUseError(
                "another episode of this process took its only simulator: reset this one to take it back, or drive "
                "both in environments (wrongturn_sim.WrongturnSimEnv), of which a process can have any number"
            )
        try:
            # SUMO's angle runs clockwise from north, its position is the front bumper's centre.
            self._move(
                EGO,
                "",
                0,
                x + _HALF_LENGTH * math.cos(yaw),
                y + _HALF_LENGTH * math.sin(yaw),
                90.0 - yaw * _DEGREES,
                KEEP_ROUTE,
            )
            self._step()
        except Exception as error:
            _Process.net = None
            _Process.holder = _nobody
            raise SimulatorFailedError(f"SUMO refused a sub-step: {error}; reset the environment") from error
        if self._crowd is not None:
            self._look(self._crowd, x, y)

    @staticmethod
    def _look(crowd: Crowd, x: float, y: float) -> None:
        try:
            crowd.update(x, y)
        except Exception as error:
            _Process.holder = _nobody
            raise SimulatorFailedError(f"SUMO does not report its traffic: {error}; reset the environment") from error

    def set_route(self, edges: tuple[str, ...]) -> bool:
        if self._crowd is None:
            return True
        if _Process.holder() is not self or self._sumo.vehicle.getRoadID(EGO) != edges[0]:
            return False
        self._sumo.vehicle.setRoute(EGO, edges)
        return True


def is_free() -> bool:
    """Return whether no episode of this process holds its simulator."""
    return _Process.holder() is None


def release(simulation: Simulation) -> None:
    """Free this process's simulator, if this simulation holds it."""
    if _Process.holder() is simulation:
        _Process.holder = _nobody


class Simulator:
    """The process's only simulator: SUMO, as an episode uses it."""

    def begin(
        self, net: Path, edge: str, x: float, y: float, yaw: float, *, seed: int, traffic: TrafficPlan | None = None
    ) -> Simulation:
        """Take the process's simulator, load a net and place a new car.

        Without traffic the net stays loaded between episodes. With traffic it is loaded each time, because SUMO's
        drivers depend on all random numbers that were drawn before.

        Args:
            net: the town's ``.net.xml``.
            edge: the edge that the car starts on.
            x: place of the body's centre, metres.
            y: place of the body's centre, metres.
            yaw: radians, counter-clockwise from east.
            seed: SUMO's random seed, used when the net is loaded.
            traffic: the other road users; None for none.

        Raises:
            SimulatorUnavailableError: libsumo cannot be loaded.
            SimulatorFailedError: SUMO cannot load the net, or it has no such edge.
        """
        if traffic is None:
            sumo = _start(net, seed % 2**31)
        else:
            _Process.net = None
            sumo = _start(net, seed % 2**31, *_WITH_TRAFFIC)
        simulation = _SumoSimulation(sumo)
        _Process.holder = weakref.ref(simulation)
        try:
            if EGO in sumo.vehicle.getIDList():
                sumo.vehicle.remove(EGO)
            if edge not in sumo.route.getIDList():
                # Other drivers give way only to a car whose route leads through their junction.
                sumo.route.add(edge, [edge] if traffic is None else traffic.ego)
            sumo.vehicle.add(EGO, edge, EGO_TYPE, depart="now")
            sumo.vehicle.setSpeedMode(EGO, 0)
            sumo.vehicle.setLaneChangeMode(EGO, 0)
        except Exception as error:
            _Process.net = None
            _Process.holder = _nobody
            raise SimulatorFailedError(f"SUMO cannot place the car on edge {edge}: {error}") from error
        simulation.move(x, y, yaw)
        if traffic is not None:
            return self._populate(sumo, traffic, x, y, yaw)
        return simulation

    @staticmethod
    def _populate(sumo: ModuleType, traffic: TrafficPlan, x: float, y: float, yaw: float) -> Simulation:
        """Let the other road users enter, now that SUMO knows where the car is."""
        _Process.net = None
        crowd = Crowd(sumo, traffic)
        try:
            crowd.enter()
        except Exception as error:
            _Process.holder = _nobody
            raise SimulatorFailedError(f"SUMO cannot place the traffic: {error}") from error
        simulation = _SumoSimulation(sumo, crowd)
        _Process.holder = weakref.ref(simulation)
        for _ in range(_SETTLING):
            simulation.move(x, y, yaw)
            if not crowd.waiting():
                break
        return simulation
