"""Faults in the plan of an agent of CARLA's leaderboard, which itself stays unchanged.

The leaderboard gives an agent its route once, by ``set_global_plan``: pairs of a place and a ``RoadOption``. Give the
leaderboard this file as ``--agent``, and your own in ``WRONGTURN_AGENT``; see ``docs/faults-elsewhere.md``.
"""

from __future__ import annotations

import importlib.util
import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wrongturn_faults.plan import faulty_plan
from wrongturn_faults.rules import OPENS

EARTH = 6378137.0
"""Radius of CARLA's earth, metres."""


def rewritten(plan_gps: list[Any], plan_world: list[Any], settings: Mapping[str, str]) -> tuple[list[Any], list[Any]]:
    """Return both plans with the commands of a fault.

    Args:
        plan_gps: pairs of a mapping with ``lat`` and ``lon`` (degrees), and a command.
        plan_world: pairs of a ``carla.Transform`` and a command.
        settings: ``WRONGTURN_FAULT`` and, if they are not the usual ones, ``WRONGTURN_DOSE``, ``WRONGTURN_PERIOD``,
            ``WRONGTURN_SEED``, ``WRONGTURN_JUNCTION``, ``WRONGTURN_WINDOW`` and ``WRONGTURN_EXITS`` (such as ``1,3``).

    Raises:
        ValueError: A setting is wrong, or the plan leads through no junction; the message names it and the remedy.
    """
    if not settings.get("WRONGTURN_FAULT"):
        return plan_gps, plan_world
    return _with(plan_gps, settings, _metres), _with(plan_world, settings, _location)


def _with(plan: list[Any], settings: Mapping[str, str], place: Any) -> list[Any]:
    exits = settings.get("WRONGTURN_EXITS")
    told = faulty_plan(
        [place(point) for point, _ in plan],
        [_number(command) for _, command in plan],
        settings["WRONGTURN_FAULT"],
        junction=_read(settings, "WRONGTURN_JUNCTION", int, 0),
        exits=None if not exits else _directions(exits),
        dose=_read(settings, "WRONGTURN_DOSE", float, None),
        period=_read(settings, "WRONGTURN_PERIOD", float, 1.0),
        seed=_read(settings, "WRONGTURN_SEED", int, 0),
        window=_read(settings, "WRONGTURN_WINDOW", float, OPENS),
    )
    return [
        (point, command if int(new) == _number(command) else _same_kind(command, int(new)))
        for (point, command), new in zip(plan, told)
    ]


def _number(command: Any) -> int:
    return int(getattr(command, "value", command))


def _same_kind(command: Any, number: int) -> Any:
    """Return a number as the agent's program has it: as its own ``RoadOption`` where the plan has those."""
    return type(command)(number)


def _metres(point: Any) -> tuple[float, float]:
    north = math.radians(point["lat"]) * EARTH
    return math.radians(point["lon"]) * EARTH * math.cos(math.radians(point["lat"])), north


def _location(point: Any) -> tuple[float, float]:
    place = getattr(point, "location", point)
    return float(place.x), float(place.y)


def _directions(text: str) -> list[int]:
    try:
        return [int(one) for one in text.split(",")]
    except ValueError:
        raise ValueError(f"WRONGTURN_EXITS: is {text!r}; give numbers of directions, such as 1,3") from None


def _read(settings: Mapping[str, str], name: str, kind: Any, usual: Any) -> Any:
    try:
        return kind(settings[name]) if settings.get(name) else usual
    except ValueError:
        raise ValueError(f"{name}: is {settings[name]!r}; give a number") from None


def get_entry_point() -> str:
    """Return the agent's class to the leaderboard: the class in the file of ``WRONGTURN_AGENT``, with faulty plans.

    Raises ValueError if the variable names no file with an agent.
    """
    path = os.environ.get("WRONGTURN_AGENT", "")
    spec = importlib.util.spec_from_file_location("wrongturn_own_agent", path) if path.endswith(".py") else None
    if spec is None or spec.loader is None or not Path(path).is_file():
        raise ValueError(
            f"WRONGTURN_AGENT: is {path!r}; name the agent's Python file, as for the leaderboard's --agent"
        )
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(Path(path).resolve().parent))
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    if not hasattr(module, "get_entry_point"):
        raise ValueError(f"WRONGTURN_AGENT: {path} has no get_entry_point(); name an agent of CARLA's leaderboard")
    own = getattr(module, module.get_entry_point())

    def set_global_plan(self: Any, plan_gps: list[Any], plan_world: list[Any]) -> None:
        """Give the agent the plan with the fault of the environment's variables."""
        own.set_global_plan(self, *rewritten(plan_gps, plan_world, os.environ))

    globals()["FaultyAgent"] = type("FaultyAgent", (own,), {"set_global_plan": set_global_plan})
    return "FaultyAgent"
