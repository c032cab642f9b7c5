"""The bridge to SUMO, and the only file that imports libsumo.

SUMO drives the other road users. Nothing that an episode reads moves in it while a car drives alone. The service
mirrors such a car all the same; environments leave SUMO out.

libsumo holds one simulation per process: a second ``start()`` silently kills the first. :class:`_Process` knows which
episode holds it. The episode that begins last takes it; the one before gets SimulatorInUseError at its next step.
"""

import math
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.trajectory import Appearance, RoadUser
from wrongturn_protocol import VEHICLE
from wrongturn_protocol.installing import install
from wrongturn_sim.ego import SUB_STEP
from wrongturn_sim.errors import SimulatorFailedError, SimulatorInUseError, SimulatorUnavailableError
from wrongturn_sim.traffic.crowd import OTHERS, Crowd, Sighting
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
    # A car enters as soon as it overlaps no other, even if another has to brake; else cars in a jam would enter late.
    *("--insertion-checks", "collision"),
)
_HALF_LENGTH: Final = VEHICLE.half_length
_DEGREES: Final = 180.0 / math.pi
_SETTLING: Final = 10


class Simulation:
    """An episode's access to everything around its car. This one is of a car that drives alone: nobody is there."""

    __slots__ = ("__weakref__", "appearances", "sightings")

    def __init__(self) -> None:
        self.sightings: list[Sighting] = []
        """The other road users within 80 m of the car, nearest first."""
        self.appearances: tuple[Appearance, ...] = ()
        """Looks of all road users, by their numbers."""

    def move(self, x: float, y: float, yaw: float) -> None:
        """Move the car's centre to a place (metres, radians) and simulate everything else for 0.05 s.

        Raises SimulatorInUseError if another episode took the simulator, SimulatorFailedError if SUMO reports an error.
        """

    def set_route(self, edges: tuple[str, ...]) -> bool:  # noqa: ARG002
        """Tell SUMO's drivers that the car will take these edges; return False if SUMO cannot take them yet."""
        return True

    def road_users(self) -> tuple[RoadUser, ...]:
        """Return the visible road users, nearest first."""
        return tuple([user for _, _, user, _ in self.sightings])

    def others(self) -> NDArray[np.float64]:
        """Return the same for pictures, (n, 8): x, y, yaw, length, width, height, kind, colour.

        Kind is 0 for a vehicle and 1 for a pedestrian. Each road user keeps its colour's number.
        """
        rows = np.empty((len(self.sightings), OTHERS))
        for row, (_, _, user, appearance) in zip(rows, self.sightings, strict=True):
            row[:] = *user[:5], *appearance
        return rows

    def numbers(self) -> tuple[int, ...]:
        """Return the numbers of the visible road users, in the same order."""
        return tuple([number for _, number, _, _ in self.sightings])


def _nobody() -> None:
    """Stand for the reference to a simulation that has ended."""


class _Process:
    """What this process has loaded, and which episode drives in it."""

    sumo: ModuleType | None = None
    holder: Callable[[], Simulation | None] = staticmethod(_nobody)
    """Returns the simulation of the episode that drives now. It is a weak reference: an episode that nobody keeps
    holds nothing."""


def load_libsumo() -> ModuleType:
    """Import and return libsumo. Raises SimulatorUnavailableError if it or a library that it needs is missing."""
    if _Process.sumo is None:
        try:
            import libsumo  # noqa: PLC0415 - only traffic needs it

            _Process.sumo = libsumo
        except ImportError as error:
            raise SimulatorUnavailableError(
                f"libsumo cannot be loaded ({error}); install the Debian packages {' '.join(DEBIAN_PACKAGES)} "
                f"and run: {install('libsumo')}"
            ) from error
    return _Process.sumo


@contextmanager
def _failing_as(message: str) -> Iterator[None]:
    """Raise what SUMO raises as SimulatorFailedError; the message has a place for it. The simulation has ended then."""
    try:
        yield
    except Exception as error:
        _Process.holder = _nobody
        raise SimulatorFailedError(message.format(error)) from error


class _SumoSimulation(Simulation):
    """A simulation in this process's SUMO; it ends when another episode begins in it."""

    __slots__ = ("_crowd", "_move", "_step", "_sumo")

    def __init__(self, sumo: ModuleType, crowd: Crowd) -> None:
        super().__init__()
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
        # SUMO's angle runs clockwise from north, its position is the front bumper's centre.
        front = x + _HALF_LENGTH * math.cos(yaw), y + _HALF_LENGTH * math.sin(yaw)
        try:
            self._move(EGO, "", 0, *front, 90.0 - yaw * _DEGREES, KEEP_ROUTE)
            self._step()
            self.sightings = self._crowd.update(x, y)
        except Exception as error:
            _Process.holder = _nobody
            raise SimulatorFailedError(f"SUMO refused a sub-step: {error}; reset the environment") from error

    def set_route(self, edges: tuple[str, ...]) -> bool:
        if _Process.holder() is not self or self._sumo.vehicle.getRoadID(EGO) != edges[0]:
            return False
        self._sumo.vehicle.setRoute(EGO, edges)
        return True


def is_free() -> bool:
    """Return whether no episode of this process holds its simulator."""
    return _Process.holder() is None


def release(simulation: Simulation | None) -> None:
    """Free this process's simulator, if this simulation holds it."""
    if _Process.holder() is simulation:
        _Process.holder = _nobody


class Simulator:
    """The process's only simulator: SUMO, as an episode with other road users uses it."""

    def begin(self, net: Path, x: float, y: float, yaw: float, traffic: TrafficPlan, *, seed: int) -> Simulation:
        """Take the process's simulator, load a town's net, place a new car and let the other road users enter.

        The body's centre is at x, y (metres), its yaw is radians, counter-clockwise from east. The traffic has the
        car's route too, on whose first edge it starts. SUMO's drivers depend on ``seed`` and on all random numbers
        that were drawn before, so the net is loaded each time.

        Raises:
            SimulatorUnavailableError: libsumo cannot be loaded.
            SimulatorFailedError: SUMO cannot load the net, or it has no such edge.
        """
        sumo = load_libsumo()
        options = ["--net-file", str(net), "--seed", str(seed % 2**31), *_OPTIONS]
        with _failing_as(f"SUMO cannot load {net.name}: {{}}; is it a net of SUMO 1.28?"):
            if sumo.isLoaded():
                sumo.load(options)
            else:
                sumo.start(["sumo", *options])
            sumo.vehicletype.copy("DEFAULT_VEHTYPE", EGO_TYPE)
            sumo.vehicletype.setLength(EGO_TYPE, VEHICLE.length)
            sumo.vehicletype.setWidth(EGO_TYPE, VEHICLE.width)
            sumo.vehicletype.setMaxSpeed(EGO_TYPE, VEHICLE.max_speed)
        crowd = Crowd(sumo, traffic)
        simulation = _SumoSimulation(sumo, crowd)
        _Process.holder = weakref.ref(simulation)
        with _failing_as(f"SUMO cannot place the car on edge {traffic.ego[0]}: {{}}"):
            for lane in traffic.closed:
                sumo.lane.setDisallowed(lane, ["all"])
            # Other drivers give way only to a car whose route leads through their junction.
            sumo.route.add(EGO, traffic.ego)
            sumo.vehicle.add(EGO, EGO, EGO_TYPE, depart="now")
            sumo.vehicle.setSpeedMode(EGO, 0)
            sumo.vehicle.setLaneChangeMode(EGO, 0)
        simulation.move(x, y, yaw)
        # The others enter now that SUMO knows where the car is.
        with _failing_as("SUMO cannot place the traffic: {}"):
            simulation.appearances = crowd.enter()
        for _ in range(_SETTLING):
            simulation.move(x, y, yaw)
            if not crowd.waiting():
                break
        return simulation
