"""The recipe of a draw as the docs give it, written anew with the standard library alone: it gives the same trials."""

import hmac
import json
import math

import pytest

from wrongturn_networks import draws, load_suite, load_town
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
    """Return all that is drawn of each trial and its twin: its id, approach, route, start and so on."""
    episodes = []
    seeds = []
    scenery = whole(secret, "scenery Town01", 2**53)
    for index, (approach, route) in enumerate(places(cells, secret, lanes)):
        room = lanes[approach][1] - 3.0
        name = None
        for role in ("trial", "twin"):
            label = f"{index} {role}"
            distance = number(secret, f"{label} distance", min(22.0, room), min(60.0, room))
            speed = min(number(secret, f"{label} speed", 4.0, 9.0), math.sqrt(16 * (distance - 16)))
            attempt = 0
            while (seed := whole(secret, f"{label} seed {attempt}", 2**31)) in seeds:
                attempt += 1
            seeds.append(seed)
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
                    round(number(secret, f"{label} watch", 1.0, 4.0), 3),
                    scenery,
                    seed,
                )
            )
    return episodes


def in_order(ids: list, secret: str) -> list:
    """Return the ids of the first half and of the second half, in the order in which they are driven."""
    pairs = list(zip(ids[::2], ids[1::2], strict=True))
    sides = [whole(secret, f"{k} first", 2) for k in range(len(pairs))]
    first = [pair[side] for pair, side in zip(pairs, sides, strict=True)]
    second = [pair[1 - side] for pair, side in zip(pairs, sides, strict=True)]
    return [in_random_order(secret, "order 1", first), in_random_order(secret, "order 2", second)]


@pytest.mark.parametrize("suite", ["smoke@3", "wrong-command@3"])
@pytest.mark.parametrize("secret", ["0f" * 32, "smoke@3", "ein Schlüssel", "4"])
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
            *(trial.window, trial.watch, trial.scenery, trial.seed),
        )
        for trial in load_suite(suite).draw(secret).episodes
    ]
    assert rebuilt(cells, secret, lanes) == drawn
    halves = draws.halves(load_suite(suite).draw(secret), secret)
    assert [[trial.id for trial in half] for half in halves] == in_order([row[0] for row in drawn], secret)
