"""The tables of ``docs/doubting.md``: ``python -m lab.doubting_pages`` writes them anew."""

import json
import re
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from lab.paths import LAB
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_agents.training.methods.doubting.config import POLICIES

FIGURES: Final = LAB / "studies" / "doubting.json"
"""Figures that ``doubting.study --json`` keeps."""
_SECTION: Final = re.compile(r"(<!-- doubting: (?P<name>[a-z-]+) -->\n).*?(<!-- end of doubting -->)", re.DOTALL)
_TOWNS: Final = ("Town01", "Town02")
_GATES: Final = {
    (): "the whole gate",
    ("omission=false",): "replaces missing exits only",
    ("infeasible=false",): "fills in missing commands only",
    ("memory=false",): "without memory",
}

Figures = dict[str, Any]


def tables(figures: Sequence[Figures]) -> dict[str, str]:
    """Return the page's tables by name."""
    return {
        "drivers": _drivers(figures),
        "fresh": _fresh(figures),
        "draws": _draws(figures),
        "reactions": _reactions(figures),
        "ablation": _ablation(figures),
        "weathers": _weathers(figures),
    }


def filled(text: str, figures: Sequence[Figures]) -> str:
    """Return a page's text with its tables anew."""
    made = tables(figures)
    return _SECTION.sub(lambda match: f"{match[1]}\n{made[match['name']]}\n\n{match[3]}", text)


def _drivers(figures: Sequence[Figures]) -> str:
    """Return the table of the files that drove: the other tables name each by its first digits."""
    found = sorted({(one["algorithm"], one["driver"]) for one in figures})
    rows = [[f"`{name}`", f"`{POLICIES[name]}`", f"`{driver}`"] for name, driver in found]
    return _table(["agent", "driver", "SHA-256 of the driver's file"], rows)


def _fresh(figures: Sequence[Figures]) -> str:
    """Return the table of draws from secrets of the agent's own."""
    shown = [one for one in figures if _plain(one) and one.get("fresh")]
    kinds = sorted({(one["algorithm"], one["seed"], one["town"], one["weather"]) for one in shown})
    rows = []
    for kind in kinds:
        own = [one for one in shown if (one["algorithm"], one["seed"], one["town"], one["weather"]) == kind]
        unsafe, trials, done, twins = (
            sum(one[name] for one in own) for name in ("unsafe_strict", "trials", "twins_completed", "twins")
        )
        name, seed, town, weather = kind
        rows.append(
            [f"`{name}`", str(seed), town, weather, str(len(own)), _each(own, "unsafe_strict"),
             f"{unsafe} of {trials}", _each(own, "twins_completed"), f"{done} of {twins}"]
        )  # fmt: skip
    return _table(
        [
            "agent",
            "seed",
            "town",
            "weather",
            "draws",
            "unsafe of 60 in each",
            "in all",
            "twins of 60 in each",
            "in all",
        ],
        rows,
    )


def _draws(figures: Sequence[Figures]) -> str:
    found: dict[tuple[str, int, str], dict[str, list[Figures]]] = {}
    for one in figures:
        if _plain(one) and one["weather"] == "ClearNoon" and not one.get("fresh"):
            agent = (one["algorithm"], one["seed"], one["driver"])
            found.setdefault(agent, {}).setdefault(one["town"], []).append(one)
    rows = []
    for name, seed, driver in sorted(found):
        row = [f"`{name}`", str(seed), _short(driver)]
        for town in _TOWNS:
            own = found[name, seed, driver].get(town)
            row += [str(len(own)), _each(own, "unsafe_strict"), _each(own, "twins_completed")] if own else ["–"] * 3
        rows.append(row)
    head = ["agent", "seed", "driver"]
    for town in _TOWNS:
        head += [f"{town}: draws", "unsafe of 60 in each", "twins of 60 in each"]
    return _table(head, rows)


def _ablation(figures: Sequence[Figures]) -> str:
    """Return the table of the agents of which a part was taken away, on the open draw, with the whole agents."""
    found: dict[tuple[str, int, str, tuple[str, ...], str], dict[str, Figures]] = {}
    for one in figures:
        if one["secret"] == WRONG_COMMAND and one["weather"] == "ClearNoon":
            kind = (one["algorithm"], one["seed"], one["variant"] or "", tuple(one["gate"]), one["driver"])
            found.setdefault(kind, {})[one["town"]] = one
    ablated = {(name, seed) for name, seed, variant, gate, _ in found if gate or variant}
    rows = []
    for name, seed, variant, gate, driver in sorted(found):
        if (name, seed) not in ablated:
            continue
        what = _GATES.get(gate, ", ".join(gate)) + (f", {variant.replace('-', ' ')}" if variant else "")
        row = [f"`{name}`", str(seed), _short(driver), what]
        for town in _TOWNS:
            own = found[name, seed, variant, gate, driver].get(town)
            row += [str(own["unsafe_strict"]), str(own["twins_completed"])] if own else ["–", "–"]
        rows.append(row)
    return _table(["agent", "seed", "driver", "gate", "Town01: unsafe", "twins", "Town02: unsafe", "twins"], rows)


def _weathers(figures: Sequence[Figures]) -> str:
    shown = [one for one in figures if _plain(one) and one["weather"] != "ClearNoon"]
    rows = [
        [f"`{one['algorithm']}`", str(one["seed"]), one["town"], one["weather"], str(one["unsafe_strict"]),
         str(one["twins_completed"])]
        for one in sorted(shown, key=lambda one: (one["algorithm"], one["town"], one["weather"], one["seed"]))
    ]  # fmt: skip
    return _table(["agent", "seed", "town", "weather", "unsafe of 60", "twins of 60"], rows)


def _reactions(figures: Sequence[Figures]) -> str:
    found: dict[tuple[str, str], Counter[str]] = {}
    for one in figures:
        for said, count in one["reactions"].items() if _plain(one) else ():
            fault, _, reaction = said.partition(" ")
            found.setdefault((one["algorithm"], fault), Counter())[reaction] += count
    rows = [
        [
            f"`{name}`",
            fault,
            str(kinds.total()),
            ", ".join(f"{reaction} {count}" for reaction, count in kinds.most_common()),
        ]
        for (name, fault), kinds in sorted(found.items())
    ]
    return _table(["agent", "fault", "trials", "reactions"], rows)


def _short(driver: str) -> str:
    return f"`{driver[:8]}`"


def _plain(one: Figures) -> bool:
    return not one["gate"] and one["variant"] is None


def _each(figures: Iterable[Figures], name: str) -> str:
    """Return a count of each draw, and how often it came: ``0 (9 times), 1``."""
    found = [one[name] for one in figures]
    return ", ".join(
        f"{value} ({found.count(value)} times)" if found.count(value) > 1 else str(value)
        for value in sorted(set(found))
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    rows = list(rows)
    if not rows:
        return "*Not driven with these drivers yet.*"
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *lines])


def main() -> int:
    """Write the page anew."""
    page = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/doubting.md")
    page.write_text(filled(page.read_text("utf-8"), json.loads(FIGURES.read_text("utf-8"))), "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
