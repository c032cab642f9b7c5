"""Names that a service keeps for its operator: those of shipped agents and algorithms, and names that mislead."""

import re
from typing import Final

SHIPPED_NAMES: Final = frozenset(
    (
        *("always-stops", "careful", "ignores-commands", "obeys-blindly", "parked", "pause-then-obey"),
        *("lbc", "lbc-privileged", "lbc-words", "marln", "ppo-auxiliary", "ppo-image", "ppo-segmentation"),
        *("doubting", "doubting-segmentation"),
        *("askew", "blocker", "broadside", "circles", "clones", "creeper", "head-on", "late-obey", "maniac"),
        *("odometer", "oncoming-lane", "pavement", "rememberer", "sleeper", "straddler", "tail", "turncoat"),
        *("twitcher", "u-turner"),
    )
)
"""Names of agents and algorithms."""
OWNER_NAME: Final = "Wrongturn"
"""Name of their owner."""
OPERATOR_NAMES: Final = frozenset({"admin", "administrator", "operator"})
"""Names that a reader could take for the operator's."""
_ID: Final = re.compile(r"(?:ow|ag|ev|ep|su)[._ -][0-9a-f]{8,}", re.IGNORECASE)
"""Names that a reader could take for ids."""
_SEPARATORS: Final = str.maketrans("", "", "._ -")
_ALIKE: Final = str.maketrans("015i", "olsl")


def looks_like(name: str, reserved: frozenset[str] = SHIPPED_NAMES) -> str | None:
    """Return the reserved name that a reader could take a name for, or None.

    Case, dots, dashes, underscores and spaces make no difference; nor do ``0`` and ``o``, ``1``, ``i`` and ``l``,
    ``5`` and ``s``, ``rn`` and ``m``, ``vv`` and ``w``.
    """
    wanted = _skeleton(name)
    return next((one for one in sorted(reserved) if _skeleton(one) == wanted), None)


def misleads(name: str) -> str | None:
    """Return what a reader could take a name for, in words: the operator, or an id. None if it is neither."""
    if looks_like(name, OPERATOR_NAMES) is not None:
        return "it reads as if it were the operator's"
    return "it reads like an id" if _ID.fullmatch(name) is not None else None


def _skeleton(name: str) -> str:
    plain = name.lower().translate(_SEPARATORS).translate(_ALIKE)
    return plain.replace("rn", "m").replace("vv", "w")
