"""The recipe of a draw as the docs give it, written anew with the standard library alone: it gives the same trials."""

import hmac
import json
import math

import pytest

from wrongturn_networks import load_suite, load_town
from wrongturn_networks.suites import SUITES

EXITS = {"STRAIGHT_LEFT": [1, 3], "STRAIGHT_RIGHT": [2, 3], "LEFT_RIGHT": [1, 2]}
"""Exits of each type, by the numbers of their commands."""


def digest(secret: str, label: str) -> bytes:
    return hmac.digest(secret.encode("utf-8"), label.encode("utf-8"), "sha256")


def number(secret: str, label: str, low: float, high: float) -> float:
    return low + (high - low) * (int.from_bytes(digest(secret, label)[:6], "big") / 2**48)


def whole(secret: str, label: str, below: int) -> int:
    return int.from_bytes(digest(secret, label)[:16], "big") % below


def in_random_order(secret: str, label: str, items: list) -> list:
    order = sorted(range(len(items)), key=lambda k: digest(secret, f"{label} {k}"))
    return [items[k] for k in order]


def places(cells: list, secret: str, lanes: dict) -> list:
    """Return approach and route of each cell. ``lanes`` gives type and lane length of each approach."""
    found = [None] * len(cells)
    for first, cell in enumerate(cells):
        group = [index for index, other in enumerate(cells) if other == cell]
        if group[0] != first:
            continue
        of_the_type = sorted(name for name, (kind, length) in lanes.items() if kind == cell["junction_type"])
        roomy = [name for name in of_the_type if lanes[name][1] >= 20.0]
        approaches = []
        while len(approaches) < len(group):
            approaches += in_random_order(secret, f"{first} approaches {len(approaches) // len(roomy)}", roomy)
        exits = in_random_order(secret, f"{first} exits", EXITS[cell["junction_type"]])
        routes = in_random_order(secret, f"{first} routes", [exits[k % len(exits)] for k in range(len(group))])
        for index, approach, route in zip(group, approaches, routes, strict=False):
            found[index] = (approach, route)
    return found


def rebuilt(cells: list, secret: str, lanes: dict) -> list:
    """Return id, approach, route, distance, speed, lateral, yaw, window and seed of each trial and its twin."""
    episodes = []
    for index, (approach, route) in enumerate(places(cells, secret, lanes)):
        room = lanes[approach][1] - 3.0
        name = None
        for role in ("trial", "twin"):
            label = f"{index} {role}"
            distance = number(secret, f"{label} distance", min(22.0, room), min(60.0, room))
            speed = min(number(secret, f"{label} speed", 4.0, 9.0), math.sqrt(16 * (distance - 16)))
            slots = 2 * len(cells)
            seed = whole(secret, f"{label} seed", 2**31 // slots) * slots + 2 * index + (role == "twin")
            name = name or f"Town01.{approach}.{{}}.s{seed}"
            episodes.append(
                (
                    name.format("none" if role == "twin" else cells[index]["fault"]["kind"]),
                    approach,
                    route,
                    round(distance, 3),
                    round(speed, 3),
                    round(number(secret, f"{label} lateral", -0.4, 0.4), 3),
                    round(math.radians(number(secret, f"{label} yaw", -6.0, 6.0)), 5),
                    round(number(secret, f"{label} window", 10.0, 20.0), 3),
                    seed,
                )
            )
    return episodes


@pytest.mark.parametrize("suite", ["smoke@2", "wrong-command@2"])
@pytest.mark.parametrize("secret", ["0f" * 32, "smoke@2", "ein Schlüssel", "4"])
def test_the_docs_recipe_gives_the_draw(suite: str, secret: str) -> None:
    cells = json.loads((SUITES / f"{suite}.json").read_text("utf-8"))["cells"]
    town = load_town("Town01")
    lanes = {
        name: (approach.type.value, town.lanes[approach.lane].length) for name, approach in town.approaches.items()
    }
    drawn = [
        (
            *(trial.id, trial.approach, trial.route),
            *(trial.start.distance, trial.start.speed, trial.start.lateral, trial.start.yaw),
            *(trial.window, trial.seed),
        )
        for trial in load_suite(suite).draw(secret).episodes
    ]
    assert rebuilt(cells, secret, lanes) == drawn
