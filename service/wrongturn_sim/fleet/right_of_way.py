"""Who gives way to whom: the rules of a town's junctions, as SUMO's network states them.

A *gate* is one way through a junction: an approach and one of its exits. It has the number ``3 * leg + exit``.
"""

import xml.etree.ElementTree as ET
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_sim.roads import roads_of

CROSSES, YIELDS = 1, 2
"""Bits of a rule: the two ways cross or merge; the first one must give way to the second."""
_SPEED: Final = 13.89  # SUMO's usual limit in towns, m/s


@lru_cache(maxsize=16)
def rules_of(town: Town) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the rules between any two gates (G, G), and the speed limit of each gate (G,), m/s."""
    root = ET.parse(town.net_file).getroot()  # noqa: S314 - a file of the town, whose checksum was compared
    limits = {lane.attrib["id"]: float(lane.get("speed", _SPEED)) for lane in root.iter("lane")}
    roads = roads_of(town)
    gates: dict[str, int] = {}
    speeds = np.full(3 * len(roads.lanes), _SPEED)
    for leg, approach in enumerate(roads.approaches):
        for k, exit_ in enumerate(approach.exits.values() if approach is not None else ()):
            gates.update(dict.fromkeys(exit_.internal_lanes, 3 * leg + k))
            speeds[3 * leg + k] = min(limits[lane] for lane in exit_.internal_lanes)
    rules = np.zeros((len(speeds), len(speeds)), np.uint8)
    for junction in root.iter("junction"):
        numbers = [gates.get(lane) for lane in junction.get("intLanes", "").split()]
        for request in junction.iter("request"):
            ours = numbers[int(request.attrib["index"])]
            for bit, name in ((CROSSES, "foes"), (YIELDS, "response")):
                # The last character is that of the first link.
                for other, flag in zip(numbers, reversed(request.attrib[name]), strict=False):
                    if flag == "1" and ours is not None and other is not None:
                        rules[ours, other] |= bit
    rules |= rules.T & CROSSES
    return rules, speeds


@lru_cache(maxsize=16)
def limits_of(town: Town) -> NDArray[np.float64]:
    """Return the speed limit of each leg's lane, (legs,), m/s."""
    root = ET.parse(town.net_file).getroot()  # noqa: S314 - as above
    limits = {lane.attrib["id"]: float(lane.get("speed", _SPEED)) for lane in root.iter("lane")}
    return np.array([limits.get(name, _SPEED) for name in roads_of(town).names])
