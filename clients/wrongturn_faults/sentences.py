"""Commands as sentences, for models that are driven by language. The phrasings stand in ``sentences@1.json``.

A phrasing never changes within a version, because results with it would not be comparable.
"""

from __future__ import annotations

import json
from pathlib import Path

from wrongturn_faults.commands import Command

VERSION = "sentences@1"
"""Name of the phrasings. A result with sentences names it."""
KINDS = ("plain", "distance", "ordinal", "ambiguous")
"""``distance`` also says how far the junction is, ``ordinal`` which one is meant; ``ambiguous`` names no direction."""
_ORDINALS = ("first", "second", "third", "fourth", "fifth")
_PHRASINGS = json.loads(Path(__file__).with_name(f"{VERSION}.json").read_text("utf-8"))


def phrasings(command: int, kind: str = "plain") -> list[str]:
    """Return the phrasings of a command, with ``{distance}`` or ``{ordinal}`` where a number goes.

    An empty list stands for silence: VOID says nothing, except ambiguously. Raises ValueError for an unknown kind.
    """
    if kind not in KINDS:
        raise ValueError(f"kind: there is no {kind!r}; give one of {', '.join(KINDS)}")
    return list(_PHRASINGS[kind].get(Command(command).name, []))


def sentence(
    command: int, kind: str = "plain", *, number: int = 0, distance: float | None = None, ordinal: int = 1
) -> str:
    """Return a command as a sentence; empty for a command that the kind leaves unsaid.

    Args:
        command: the command that is delivered, right or wrong.
        kind: one of :data:`KINDS`.
        number: which phrasing, from 0; after the last the first follows.
        distance: metres to the stop line, for ``distance``; said as a whole number.
        ordinal: which of the next junctions is meant, for ``ordinal``; 1 is the next.

    Raises:
        ValueError: an argument is wrong. The message names it.
    """
    found = phrasings(command, kind)
    if number < 0:
        raise ValueError(f"number: is {number}; give 0 or more")
    if kind == "distance" and (distance is None or not 0.0 <= distance < 10_000.0):
        raise ValueError(f"distance: is {distance}; give metres to the stop line, 0 or more")
    if not 1 <= ordinal <= len(_ORDINALS):
        raise ValueError(f"ordinal: is {ordinal}; give 1 to {len(_ORDINALS)}")
    if not found:
        return ""
    return found[number % len(found)].format(distance=round(distance or 0.0), ordinal=_ORDINALS[ordinal - 1])
