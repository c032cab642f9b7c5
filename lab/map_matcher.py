"""Exploits ``map-matcher``, ``skyline`` and ``roadline``: they find their start by the first picture.

From then on they drive a simulation of their own.

The town, the renderer and the car are public. So an agent of the camera track can render pictures from everywhere,
compare them with the one that it gets, and then compute where it is at every step, to a fraction of a millimetre. It
needs the simulation, which agents may not import.
"""

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.baselines import Careful
from wrongturn_networks import load_town
from wrongturn_protocol import Action, Fault, FaultKind, JunctionType, SegmentationClass, Start, Track, Trial
from wrongturn_protocol.observations import Observation
from wrongturn_sim.camera import Renderer, World
from wrongturn_sim.ego import SUB_STEP, SUB_STEPS, State, advance
from wrongturn_sim.episode import observe_privileged
from wrongturn_sim.route import Navigator, start_pose

FOCAL = 107.4
"""Pixels."""
HORIZON = 26
"""Rows of a picture above the horizon."""
SKY = 200
"""Blue of the sky, and more."""
GROUND = (SegmentationClass.ROAD, SegmentationClass.LANE_MARKING, SegmentationClass.SIDEWALK)
"""Classes that no scenery changes."""
SHIFTS = range(-12, 13, 2)
"""By how many columns of the small picture a picture is moved when it is looked up: up to 13 degrees of yaw."""
GOOD = 0.05
"""Mean difference of two pictures, of 255, below which they show the same place."""

Place = tuple[str, float, float, float]
"""Approach, metres before the stop line, metres to the left of the lane's centre, radians to the left."""


class MapMatcher:
    """Drives as ``careful`` does in the privileged track, from pictures alone."""

    name = "map-matcher"
    track = Track.CAMERA

    def __init__(self, town: str = "Town01") -> None:
        self._town = load_town(town)
        self._renderer = Renderer(World.of(self._town))
        self._driver = Careful()
        paper = {JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT, JunctionType.LEFT_RIGHT}
        self._places: list[Place] = [
            (name, float(distance), 0.0, 0.0)
            for name, approach in sorted(self._town.approaches.items())
            if approach.type in paper
            for distance in np.arange(22.0, min(60.0, self._town.lanes[approach.lane].length - 3.0), 0.75)
        ]
        self._bank = np.stack([self.signature(self._seen_from(place)) for place in self._places])
        self._state: State | None = None
        self._navigator: Navigator | None = None

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Forget the last episode."""
        self._driver.reset(observation_space)
        self._state = None

    def act(self, observation: Observation) -> Action:
        """Return what the rule driver does where the car must be."""
        if self._state is None:
            self._begin(observation)
        assert self._state is not None
        assert self._navigator is not None
        self._navigator.update(self._state[0], self._state[1])
        seen = observe_privileged(self._state, observation["command"][0], self._navigator, ())
        action = self._driver.act(seen)
        steer, throttle, brake = (float(np.float32(part)) for part in (action.steer, action.throttle, action.brake))
        for _ in range(SUB_STEPS):
            self._state = advance(*self._state, steer, throttle, brake, SUB_STEP)
        return action

    def _begin(self, observation: Observation) -> None:
        place = self.locate(observation["rgb"])
        pose = start_pose(self._town, self._trial(place))
        self._state = (*pose, float(observation["speed"][0]), float(observation["steering"][0]))
        self._navigator = Navigator(self._town, self._trial(place))

    def locate(self, picture: NDArray[np.uint8]) -> Place:
        """Return the place from which a picture was taken."""
        found, best = self._places[0], math.inf
        for rough in self._rough(self.signature(picture)):
            place, difference = self._refined(rough, self.compared(picture))
            if difference < best:
                found, best = place, difference
            if best < GOOD:
                break
        return found

    def _rough(self, small: NDArray[np.float32]) -> list[Place]:
        """Return the places of the bank that look most alike, the best first."""
        scored: list[tuple[float, int, int]] = []
        width = small.shape[1]
        for shift in SHIFTS:
            left, right = max(0, shift), width + min(0, shift)
            moved = np.roll(small, shift, axis=1)[:, left:right]
            differences = _difference(self._bank[:, :, left:right], moved, (1, 2, 3))
            scored += [(float(differences[k]), int(k), shift) for k in np.argsort(differences)[:3]]
        places = []
        for _, k, shift in sorted(scored)[:6]:
            approach, distance, _, _ = self._places[k]
            places.append((approach, distance, 0.0, -math.atan(2.0 * shift / FOCAL)))
        return places

    def _refined(self, rough: Place, small: NDArray[np.float32]) -> tuple[Place, float]:
        """Return the best place near a rough one, and how much its picture differs."""
        from scipy.optimize import minimize  # takes half a second

        approach, distance, lateral, yaw = rough

        def difference(at: NDArray[np.float64]) -> float:
            place = (approach, float(at[0]), float(at[1]), float(at[2]) / 20.0)
            return float(_difference(self.compared(self._seen_from(place)), small))

        begin = np.array((distance, lateral, 20.0 * yaw))
        simplex = np.stack((begin, *(begin + np.diag((0.5, 0.25, 0.6)))))
        options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxiter": 150}
        found = minimize(difference, begin, method="Nelder-Mead", options=options)
        return (approach, float(found.x[0]), float(found.x[1]), float(found.x[2]) / 20.0), float(found.fun)

    def signature(self, picture: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return what is looked up in the table of places, (height, width, numbers)."""
        return _small(picture)

    def compared(self, picture: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return what is compared with the pictures near a place of the table."""
        return _small(picture)

    def _seen_from(self, place: Place) -> NDArray[Any]:
        return self._drawn_from(place)[0]

    def _drawn_from(self, place: Place) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        picture, classes = self._renderer.render(*start_pose(self._town, self._trial(place)))
        return picture, classes

    def _trial(self, place: Place) -> Trial:
        name, distance, lateral, yaw = place
        kind = self._town.approach(name).type
        return Trial(
            id="own",
            town=self._town.name,
            approach=name,
            junction_type=kind,
            route=min(kind.exits),
            start=Start(distance=distance, speed=5.0, lateral=lateral, yaw=yaw),
            fault=Fault(kind=FaultKind.NONE),
            seed=0,
        )


class Skyline(MapMatcher):
    """Looks only the skyline up: how much sky each column shows. Houses and trees make it."""

    name = "skyline"

    def signature(self, picture: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the rows of sky above the horizon in each column of the small picture, (1, 96, 1)."""
        red, _, blue = (picture[:HORIZON, :, part].astype(np.int16) for part in range(3))
        rows = ((blue > SKY) & (blue > red + 20)).sum(0, dtype=np.float32)
        return np.asarray(rows.reshape(1, -1, 2).mean(2)[:, :, None])


class Roadline(MapMatcher):
    """Compares the ground alone, which is the same whatever stands beside it."""

    name = "roadline"

    def _seen_from(self, place: Place) -> NDArray[Any]:
        picture, classes = self._drawn_from(place)
        return np.where(np.isin(classes, GROUND)[:, :, None], picture, np.float32(np.nan))


def _difference(one: NDArray[Any], other: NDArray[Any], axis: tuple[int, ...] | None = None) -> NDArray[np.float32]:
    """Return the mean difference of two pictures where both are known; one of more than 30 counts as 30."""
    return np.asarray(np.nanmean(np.minimum(np.abs(one - other), 30.0), axis))


def _small(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return a picture at half its size."""
    height, width, colours = picture.shape
    halves = picture.reshape(height // 2, 2, width // 2, 2, colours)
    return np.asarray(halves.mean((1, 3), dtype=np.float32))
