"""The bridge to SUMO, and the only file that imports libsumo.

libsumo holds one simulation to a process: a second ``start()`` silently kills the first. So the process has one
:class:`_Process`, and whoever begins an episode takes it; an environment that was displaced is told so at its next
step instead of driving in a stranger's town.
"""

import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_sim.ego import SUB_STEP, VEHICLE
from wrongturn_sim.errors import (
    SimulatorFailedError,
    SimulatorInUseError,
    SimulatorUnavailableError,
)
from wrongturn_sim.traffic.crowd import OTHERS, Crowd
from wrongturn_sim.traffic.plan import TrafficPlan
from wrongturn_sim.trajectory import RoadUser

EGO: Final = "ego"
EGO_TYPE: Final = "wrongturn-ego"
KEEP_ROUTE: Final = 2
"""``moveToXY``: put the car exactly there, on the road or off it."""
DEBIAN_PACKAGES: Final = ("libx11-6", "libxext6", "libxrender1", "libgl1", "libatomic1")
"""What libsumo's wheel links to and slim images lack."""

_OPTIONS: Final = (
    *("--step-length", str(SUB_STEP)),
    *("--no-step-log", "true"),
    *("--no-warnings", "true"),
    *("--duration-log.disable", "true"),
    *("--collision.action", "none"),  # its collision list is wrong for a car that is moved by hand
    *("--time-to-teleport", "-1"),
    *("--time-to-teleport.highways", "-1"),
    *("--xml-validation", "never"),
    *("--xml-validation.net", "never"),
)
_WITH_TRAFFIC: Final = ("--insertion-checks", "collision")
"""Cars come in where they do not overlap another, though it may have to brake; else one of a jam would come late."""
_HALF_LENGTH: Final = VEHICLE.half_length
_DEGREES: Final = 180.0 / math.pi
_SETTLING: Final = 10
_NOBODY: Final = np.empty((0, OTHERS))
_NOBODY.setflags(write=False)


class _Process:
    """What this process has loaded, and who drives in it."""

    sumo: ModuleType | None = None
    net: Path | None = None
    """Which net is loaded, while nobody but an ego has driven in it."""
    holder: object = None


def load_libsumo() -> ModuleType:
    """The libsumo module.

    Raises:
        SimulatorUnavailableError: it is not installed, or a library that it links to is missing.
    """
    if _Process.sumo is None:
        try:
            import libsumo  # noqa: PLC0415  only what drives needs it

            _Process.sumo = libsumo
        except ImportError as error:
            raise SimulatorUnavailableError(
                f"libsumo cannot be loaded ({error}); install the Debian packages {' '.join(DEBIAN_PACKAGES)} "
                "and `pip install libsumo`",
            ) from error
    return _Process.sumo


def _start(net: Path, seed: int, *more: str) -> ModuleType:
    """A simulation of the net, freshly loaded unless it is there already."""
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


class Simulation:
    """One episode's hold on the simulation: good until somebody else begins one in this process."""

    __slots__ = ("_move", "_step")

    def __init__(self, move: Callable[..., Any], step: Callable[..., Any]) -> None:
        self._move = move
        self._step = step

    def move(self, x: float, y: float, yaw: float) -> None:
        """Put the car there (body's centre) and let 0.05 s pass for everything else.

        Raises:
            SimulatorInUseError: another environment took the simulator since.
            SimulatorFailedError: SUMO refused.
        """
        if _Process.holder is not self:
            raise SimulatorInUseError(
                "another environment of this process took the simulator, there is one to a process: "
                "reset this one to take it back, or give each environment a process of its own with "
                "gymnasium.vector.AsyncVectorEnv (Stable-Baselines3: SubprocVecEnv)",
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
            _Process.net = _Process.holder = None
            raise SimulatorFailedError(f"SUMO refused a sub-step: {error}; reset the environment") from error

    def set_route(self, edges: tuple[str, ...]) -> bool:  # noqa: ARG002
        """Let others expect the car to go along these edges from now on; whether that could be done yet."""
        return True

    def road_users(self) -> tuple[RoadUser, ...]:
        """The others within 80 m of the car, nearest first."""
        return ()

    def others(self) -> NDArray[np.float64]:
        """The same for pictures, float64 (n, 8): x, y, yaw, length, width, height, kind, colour.

        Kind is 0 for a vehicle and 1 for a pedestrian; a colour is a number that stays with its bearer.
        """
        return _NOBODY


class _TrafficSimulation(Simulation):
    """A drive with traffic."""

    __slots__ = ("_crowd", "_sumo")

    def __init__(self, sumo: ModuleType, crowd: Crowd) -> None:
        super().__init__(sumo.vehicle.moveToXY, sumo.simulationStep)
        self._sumo = sumo
        self._crowd = crowd

    def move(self, x: float, y: float, yaw: float) -> None:
        super().move(x, y, yaw)
        try:
            self._crowd.update(x, y)
        except Exception as error:
            _Process.holder = None
            raise SimulatorFailedError(f"SUMO does not tell its traffic: {error}; reset the environment") from error

    def set_route(self, edges: tuple[str, ...]) -> bool:
        if _Process.holder is not self or self._sumo.vehicle.getRoadID(EGO) != edges[0]:
            return False
        self._sumo.vehicle.setRoute(EGO, edges)
        return True

    def road_users(self) -> tuple[RoadUser, ...]:
        return self._crowd.road_users()

    def others(self) -> NDArray[np.float64]:
        return self._crowd.others()


class Simulator:
    """SUMO as an episode sees it: begin a drive in a town's net, the only one of this process from then on."""

    def begin(
        self,
        net: Path,
        edge: str,
        x: float,
        y: float,
        yaw: float,
        *,
        seed: int,
        traffic: TrafficPlan | None = None,
    ) -> Simulation:
        """Take the process's simulation, with the net loaded, and put a new car into it.

        With traffic the net is loaded freshly and not kept, since SUMO's drivers depend on all that was drawn before.

        Args:
            net: the town's ``.net.xml``; it is kept loaded between episodes.
            edge: where the car comes from, one of the net's.
            x: of the body's centre, metres.
            y: of the body's centre, metres.
            yaw: radians, counter-clockwise from east.
            seed: SUMO's own, used when the net is loaded.
            traffic: who else there is.

        Raises:
            SimulatorUnavailableError: libsumo cannot be loaded.
            SimulatorFailedError: SUMO cannot load the net, or does not know the edge.
        """
        if traffic is None:
            sumo = _start(net, seed % 2**31)
        else:
            _Process.net = None
            sumo = _start(net, seed % 2**31, *_WITH_TRAFFIC)
        simulation = Simulation(sumo.vehicle.moveToXY, sumo.simulationStep)
        _Process.holder = simulation
        try:
            if EGO in sumo.vehicle.getIDList():
                sumo.vehicle.remove(EGO)
            if edge not in sumo.route.getIDList():
                # Others give way to whoever comes by a route that leads through their junction.
                sumo.route.add(edge, [edge] if traffic is None else traffic.ego)
            sumo.vehicle.add(EGO, edge, EGO_TYPE, depart="now")
            sumo.vehicle.setSpeedMode(EGO, 0)
            sumo.vehicle.setLaneChangeMode(EGO, 0)
        except Exception as error:
            _Process.net = _Process.holder = None
            raise SimulatorFailedError(f"SUMO cannot place the car on edge {edge}: {error}") from error
        simulation.move(x, y, yaw)
        if traffic is not None:
            return self._populate(sumo, traffic, x, y, yaw)
        return simulation

    @staticmethod
    def _populate(sumo: ModuleType, traffic: TrafficPlan, x: float, y: float, yaw: float) -> Simulation:
        """Let the others in, now that they see where the car is."""
        _Process.net = None
        crowd = Crowd(sumo, traffic)
        try:
            crowd.enter()
        except Exception as error:
            _Process.holder = None
            raise SimulatorFailedError(f"SUMO cannot place the traffic: {error}") from error
        simulation = _TrafficSimulation(sumo, crowd)
        _Process.holder = simulation
        for _ in range(_SETTLING):
            simulation.move(x, y, yaw)
            if not crowd.waiting():
                break
        return simulation
