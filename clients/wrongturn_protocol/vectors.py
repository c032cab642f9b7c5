"""Arguments of the vector environments, in process and against a service: seeds, trials, masks and actions."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from wrongturn_protocol.episodes import CONTROLS
from wrongturn_protocol.suggestions import did_you_mean
from wrongturn_protocol.trial_options import OptionError, check_options

Flags = NDArray[np.bool_]

_OPTIONS: Final = ("trial", "reset_mask")
"""What ``options`` of a vector environment's ``reset`` may hold."""


def whole_number(name: str, value: object) -> int:
    """Return an argument that counts something; raise OptionError if it is not a whole number, 1 or more."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise OptionError(f"{name}: is {value!r}; give a whole number, 1 or more")
    return int(value)


def autoreset_mode_of(mode: AutoresetMode | str) -> AutoresetMode:
    """Return a mode by its name, such as ``SameStep``; raise OptionError if it is not known."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        names = [one.value for one in AutoresetMode]
        raise OptionError(
            f"autoreset_mode: {mode!r} is not known; give {', '.join(names)}{did_you_mean(mode, names)}"
        ) from None


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return a seed for each environment. A single seed is the first one's; each next one is 1 higher."""
    seeds = [None if seed is None else seed + i for i in range(count)] if not isinstance(seed, Sequence) else list(seed)
    _check_number("seed", len(seeds), count)
    return seeds


def trials_of(options: dict[str, Any] | None, count: int, single: type | tuple[type, ...]) -> list[Any]:
    """Return the trial in ``options`` for each environment: one for all, of a type in ``single``, or one for each."""
    given = check_options(options, _OPTIONS).get("trial")
    if given is None or isinstance(given, single):
        return [given] * count
    if not isinstance(given, Sequence):
        raise OptionError(f"options.trial: is {given!r}; give one trial, or one for each environment")
    trials = list(given)
    _check_number("options.trial", len(trials), count)
    return trials


def mask_of(options: dict[str, Any] | None, count: int) -> list[int]:
    """Return the indices of the environments in ``options["reset_mask"]``; all of them by default."""
    mask = np.asarray((options or {}).get("reset_mask", np.ones(count, np.bool_)))
    if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
        raise OptionError(f"options.reset_mask: give ({count},) of bool, one of them True at least")
    chosen: list[int] = np.flatnonzero(mask).tolist()
    return chosen


def checked_actions(actions: Any, driven: Flags, error: type[Exception]) -> NDArray[np.float64]:
    """Return the actions as float64 (n, 3), or raise ``error``; rows that are not driven are not checked."""
    count = len(driven)
    wanted = f"actions: give ({count}, 3) numbers, steer, throttle and brake of each environment"
    try:
        kind = np.asarray(actions).dtype
        # Converted from what was given: an Action is float32 unless float64 is asked for, and would lose digits.
        given = np.asarray(actions, np.float64) if kind.kind in "bfiu" else None
    except (RuntimeError, TypeError, ValueError) as cause:  # lists of different lengths, a tensor on a GPU
        raise error(f"{wanted} ({cause})") from cause
    if given is None:
        raise error(f"{wanted}, not {kind}")
    if given.shape != (count, 3):
        raise error(f"{wanted}, not the shape {given.shape}")
    right = (given >= (-1.0, 0.0, 0.0)) & (given <= 1.0) | ~driven[:, None]
    if not right.all():
        i, k = np.argwhere(~right)[0].tolist()
        low = -1 if k == 0 else 0
        raise error(f"actions[{i}].{CONTROLS[k]}: is {given[i, k]}; give a number from {low} to 1")
    return given


def _check_number(name: str, number: int, count: int) -> None:
    if number != count:
        raise OptionError(f"{name}: has {number} entries; give one for each of {count} environments")
