"""What an episode sees of its simulation: the car's moves go in, the other road users come out."""

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.trajectory import Appearance, RoadUser
from wrongturn_sim.traffic.crowd import Surroundings


class Simulation:
    """An episode's access to everything around its car. This one is of a car that drives alone, and simulates nothing.

    Args:
        around: the other road users; nobody by default.
    """

    __slots__ = ("__weakref__", "around")

    def __init__(self, around: Surroundings | None = None) -> None:
        self.around = around or Surroundings()

    def move(self, x: float, y: float, yaw: float) -> None:
        """Move the car's centre to a place (metres, radians) and simulate everything else for 0.05 s.

        Raises:
            SimulatorInUseError: another episode took the simulator.
            SimulatorFailedError: SUMO reported an error.
        """

    def set_route(self, edges: tuple[str, ...]) -> bool:  # noqa: ARG002
        """Tell SUMO's drivers that the car will take these edges; return False if SUMO cannot take them yet."""
        return True

    def road_users(self) -> tuple[RoadUser, ...]:
        """Return the other road users within 80 m of the car, nearest first."""
        return self.around.road_users()

    def others(self) -> NDArray[np.float64]:
        """Return the same for pictures, float64 (n, 8): x, y, yaw, length, width, height, kind, colour.

        Kind is 0 for a vehicle and 1 for a pedestrian. Each road user keeps its colour's number.
        """
        return self.around.others()

    def numbers(self) -> tuple[int, ...]:
        """Return the numbers of :meth:`road_users`, in the same order."""
        return self.around.numbers()

    def appearances(self) -> tuple[Appearance, ...]:
        """Return the looks of all road users, by their numbers."""
        return self.around.appearances
