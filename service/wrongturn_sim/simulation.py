"""What an episode sees of its simulation: the car's moves go in, the other road users come out."""

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge.trajectory import Appearance, RoadUser
from wrongturn_sim.traffic.crowd import OTHERS, Sighting


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

        Raises:
            SimulatorInUseError: another episode took the simulator.
            SimulatorFailedError: SUMO reported an error.
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
