"""Cruises: drives through a town without a goal, for training. They are never scored.

A cruise begins anywhere on a lane that leads to a junction. More of them begin where driving is hard: before and inside
junctions, equally often at each approach, and before bends.
"""

import bisect
import itertools
import math
import random as generators
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from wrongturn_networks.errors import CruiseError
from wrongturn_networks.lanes import bends_of
from wrongturn_networks.per_net import once_per_net
from wrongturn_networks.starts import LANE_RESERVE, WINDOW
from wrongturn_networks.town import Town
from wrongturn_networks.ways import path_length
from wrongturn_protocol import Command, Fault, FaultKind, Journey, JunctionType, Start, Task, Traffic, Trial, Weather

BEFORE_JUNCTION: Final = (5.0, 35.0)
"""Range of the distance to the stop line for starts near a junction, metres; short lanes cut it."""
BEFORE_BEND: Final = (5.0, 25.0)
"""Range of the distance to the bend for starts near a bend, metres; short lanes cut it."""
INSIDE_SPEED: Final = 5.0
"""Greatest speed of starts inside a junction, m/s: a faster car could not follow the path of a turn."""
WITHIN: Final = 2.5
"""Offset and heading are clipped at this many standard deviations, so no car starts in the oncoming lane."""

_NO_FAULT: Final = Fault(kind=FaultKind.NONE)
_NO_TRAFFIC: Final = Traffic()


class _Stretch(NamedTuple):
    """A piece of a lane on which cruises can begin."""

    approach: str
    type: JunctionType
    exits: tuple[Command, ...]
    paths: dict[Command, float]
    """Length of each exit's path, from the stop line to the exit line, metres."""
    nearest: float
    """Least and greatest distance to the stop line, metres."""
    farthest: float


class _Stretches(NamedTuple):
    """The stretches of a town, by what they are near to."""

    junctions: tuple[_Stretch, ...]
    bends: tuple[_Stretch, ...]
    lanes: tuple[_Stretch, ...]
    metres: tuple[float, ...]
    """Cumulative length of the stretches in ``lanes``, metres."""


def draw_cruise(
    town: Town,
    random: np.random.Generator,
    *,
    weather: Weather = Weather.CLEAR_NOON,
    traffic: Traffic = _NO_TRAFFIC,
    near_junctions: float = 0.4,
    near_bends: float = 0.25,
    inside_junctions: float = 0.0,
    lateral: float = 0.4,
    yaw: float = 0.06,
    speed: tuple[float, float] = (0.0, 9.0),
    window: tuple[float, float] | None = WINDOW,
    time_limit: float = 60.0,
    alone: float = 0.0,
    least_traffic: Traffic | None = None,
) -> Trial:
    """Draw a trial without a goal; its seed decides the exit at each junction. Raises CruiseError.

    Args:
        town: town to drive in.
        random: generator of everything that is drawn, the trial's seed included.
        weather: weather of the trial.
        traffic: other road users.
        near_junctions: share of the starts shortly before a junction, 0 to 1.
        near_bends: share of the starts shortly before a bend; in a town without bends these lie anywhere.
        inside_junctions: share of the starts inside a junction, on the route's path from the stop line to the exit
            line, at 5 m/s or less. ``start.distance`` is then negative.
        lateral: standard deviation of the start's offset from the lane's centre line, metres, clipped at 2.5 of them.
        yaw: standard deviation of the start's heading, radians, clipped likewise.
        speed: least and greatest speed at the start, m/s.
        window: least and greatest distance before the stop lines at which the command's window opens, metres. Each
            cruise draws one. None: the nominal 15 m.
        time_limit: seconds.
        alone: share of the cruises without other road users, although ``traffic`` has some.
        least_traffic: each of the others draws numbers from these up to those of ``traffic``. None: always ``traffic``.
    """
    # Hundreds of environments call this at each end of an episode: hence the tables, and models without validation.
    shares = (near_junctions, near_bends, inside_junctions)
    if not (min(shares) >= 0.0 and sum(shares) <= 1.0):
        raise CruiseError(
            f"near_junctions, near_bends, inside_junctions: {near_junctions}, {near_bends} and {inside_junctions} are "
            "not shares of a whole; give three of at least 0 that add up to at most 1"
        )
    if not 0.0 <= speed[0] <= speed[1] <= 22.0:
        raise CruiseError(f"speed: {speed} is not a range within 0 and 22 m/s; give the least and the greatest speed")
    if not (0.0 <= lateral <= 0.7 and 0.0 <= yaw <= 0.3):
        raise CruiseError(
            f"lateral, yaw: {lateral} m and {yaw} rad would start cars off their lane; give at most 0.7 m and 0.3 rad"
        )
    if window is not None and not 0.0 < window[0] <= window[1] <= 60.0:
        raise CruiseError(
            f"window: {window} is not a range within 0 and 60 m; give the least and the greatest distance, or None"
        )
    if not 0.0 <= alone <= 1.0:
        raise CruiseError(f"alone: {alone} is no share of the cruises; give a number from 0 to 1")
    if not 0.0 < time_limit < math.inf:
        raise CruiseError(f"time_limit: {time_limit} is no time to drive; give seconds, more than 0")
    least = traffic if least_traffic is None else least_traffic
    if least.vehicles > traffic.vehicles or least.pedestrians > traffic.pedestrians:
        raise CruiseError(f"least_traffic: {least} is more than traffic, {traffic}; give fewer")
    stretches = _stretches(town)
    kind, which, where, fast, turn = random.random(5).tolist()
    inside = kind < inside_junctions
    if kind < inside_junctions + near_junctions:
        stretch = stretches.junctions[int(which * len(stretches.junctions))]
    elif kind < inside_junctions + near_junctions + near_bends and stretches.bends:
        stretch = stretches.bends[int(which * len(stretches.bends))]
    else:
        stretch = stretches.lanes[bisect.bisect_right(stretches.metres, which * stretches.metres[-1])]
    aside, askew = random.standard_normal(2).tolist()
    seed = int(random.integers(2**53))
    route = stretch.exits[int(turn * len(stretch.exits))]
    # A generator of its own, so that the window does not shift the cruises that follow.
    opens = None if window is None else round(generators.Random(f"window {seed}").uniform(*window), 3)
    distance, fastest = stretch.nearest + where * (stretch.farthest - stretch.nearest), speed[1]
    if inside:
        # Not 0: only a start past the stop line lies on the path.
        distance, fastest = -max(0.001, where * stretch.paths[route]), max(speed[0], min(INSIDE_SPEED, speed[1]))
    return Trial.model_construct(
        id=f"{town.name}.cruise.{stretch.approach}.s{seed}",
        town=town.name,
        approach=stretch.approach,
        junction_type=stretch.type,
        route=route,
        start=Start.model_construct(
            distance=round(distance, 3),
            speed=round(speed[0] + fast * (fastest - speed[0]), 3),
            lateral=round(lateral * min(max(aside, -WITHIN), WITHIN), 3),
            yaw=round(yaw * min(max(askew, -WITHIN), WITHIN), 5),
        ),
        weather=weather,
        traffic=_company(least, traffic, alone, seed),
        fault=_NO_FAULT,
        seed=seed,
        window=opens,
        scenery=town.scenery_seed,
        journey=_cruise(time_limit),
    )


def _company(least: Traffic, most: Traffic, alone: float, seed: int) -> Traffic:
    """Return the other road users of a cruise."""
    if alone == 0.0 and least is most:
        return most
    # A generator of its own, so that traffic does not shift the cruises that follow.
    draw = generators.Random(f"traffic {seed}")
    if draw.random() < alone:
        return _NO_TRAFFIC
    return Traffic.model_construct(
        vehicles=draw.randint(least.vehicles, most.vehicles),
        pedestrians=draw.randint(least.pedestrians, most.pedestrians),
    )


@lru_cache(maxsize=64)
def _cruise(time_limit: float) -> Journey:
    return Journey(task=Task.CRUISE, time_limit=time_limit)


@once_per_net(16)
def _stretches(town: Town) -> _Stretches:
    junctions, bends, lanes = [], [], []
    for approach in town.approaches.values():
        lane = town.lanes[approach.lane]
        paths = {direction: path_length(exit_) for direction, exit_ in approach.exits.items()}
        what = (approach.id, approach.type, tuple(approach.exits), paths)
        farthest = lane.length - LANE_RESERVE
        nearest = min(BEFORE_JUNCTION[0], farthest)
        junctions.append(_Stretch(*what, nearest, min(BEFORE_JUNCTION[1], farthest)))
        lanes.append(_Stretch(*what, nearest, farthest))
        for bend in bends_of(lane):
            there = lane.length - bend.begin
            if there + BEFORE_BEND[0] < farthest:
                bends.append(_Stretch(*what, there + BEFORE_BEND[0], min(there + BEFORE_BEND[1], farthest)))
    metres = tuple(itertools.accumulate(lane.farthest - lane.nearest for lane in lanes))
    return _Stretches(tuple(junctions), tuple(bends), tuple(lanes), metres)
