"""What vectorised environments take, in process and over the wire alike: seeds, trials, masks and actions."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]

_FIELDS: Final = ("steer", "throttle", "brake")


def whole_number(name: str, value: object) -> int:
    """The value of an argument that counts something. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"{name}: is {value!r}; give a whole number, 1 or more")
    return int(value)


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed for each environment: of one seed, the next ones' are 1 higher each.

    Raises:
        ValueError: there are more or fewer.
    """
    seeds = [None if seed is None else seed + i for i in range(count)] if not isinstance(seed, Sequence) else list(seed)
    _check_number("seed", len(seeds), count)
    return seeds


def trials_of(options: dict[str, Any] | None, count: int, single: type | tuple[type, ...]) -> list[Any]:
    """``options["trial"]``, shared out: one for all of them, of a type of ``single``; or one for each.

    Raises:
        ValueError: there are more or fewer, or it is neither.
    """
    given = (options or {}).get("trial")
    if given is None or isinstance(given, single):
        return [given] * count
    if not isinstance(given, Sequence):
        raise ValueError(f"options.trial: is {given!r}; give one trial, or one for each environment")
    trials = list(given)
    _check_number("options.trial", len(trials), count)
    return trials


def mask_of(options: dict[str, Any] | None, count: int) -> list[int]:
    """The environments that ``options["reset_mask"]`` names; all of them where it is left out.

    Raises:
        ValueError: it is no mask, or of none.
    """
    mask = np.asarray((options or {}).get("reset_mask", np.ones(count, np.bool_)))
    if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(f"options.reset_mask: give ({count},) of bool, one of them True at least")
    chosen: list[int] = np.flatnonzero(mask).tolist()
    return chosen


def checked_actions(actions: Any, driven: Flags, error: type[Exception]) -> NDArray[np.float64]:
    """Actions of each environment, (n, 3); those that are not driven may be anything of this shape.

    Args:
        actions: steer, throttle and brake of each.
        driven: (n,): whose are looked at.
        error: what is raised where one is no action.
    """
    count = len(driven)
    try:
        given = np.asarray(actions, np.float64)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape != (count, 3):
        raise error(f"actions: give ({count}, 3) numbers, steer, throttle and brake of each environment")
    right = (given >= (-1.0, 0.0, 0.0)) & (given <= 1.0) | ~driven[:, None]
    if not right.all():
        i, k = np.argwhere(~right)[0].tolist()
        low = -1 if k == 0 else 0
        raise error(f"actions[{i}].{_FIELDS[k]}: is {given[i, k]}; give a number from {low} to 1")
    return given


def _check_number(name: str, number: int, count: int) -> None:
    if number != count:
        raise ValueError(f"{name}: has {number} entries; give one for each of {count} environments")
