"""Checks of the simulation for ``wrongturn doctor``."""

from collections.abc import Callable, Iterator
from typing import Any

from wrongturn_judge.home import CACHE_VARIABLE, set_cache, writable

Check = tuple[str, bool, str, str]
"""Name, whether it passed, what was found, and the remedy where it failed."""


def _libsumo() -> str:
    from wrongturn_sim.simulator import load_libsumo  # noqa: PLC0415

    return str(load_libsumo().simulation.getVersion()[1])


def _cache() -> str:
    directory = set_cache()
    if not writable(directory):
        raise PermissionError(f"{directory} cannot be written")
    return str(directory)


def _kernels() -> str:
    from wrongturn_sim.ego import SUB_STEP, advance  # noqa: PLC0415

    compiled: Any = advance
    arguments = (0.0, 0.0, 0.0, 5.0, 0.0, 0.5, 0.5, 0.0, SUB_STEP)
    if compiled(*arguments) != compiled.py_func(*arguments):
        raise ArithmeticError("compiled and plain Python differ, so verdicts may differ from other machines'")
    return "compiled and plain Python agree"


def _episode() -> str:
    from wrongturn_networks import draw_trial, load_town  # noqa: PLC0415
    from wrongturn_protocol import FaultKind, Track, Traffic  # noqa: PLC0415
    from wrongturn_sim.episode import Episode  # noqa: PLC0415

    town = load_town("junctions")
    trial = draw_trial(town, sorted(town.approaches)[0], FaultKind.NONE, 0, traffic=Traffic(vehicles=1))
    episode = Episode(trial, Track.STATE)
    episode.reset()
    for _ in range(10):
        episode.step(0.0, 0.3, 0.0)
    return f"one second in {town.name}"


_CHECKS: tuple[tuple[str, Callable[[], str], str], ...] = (
    ("libsumo", _libsumo, "install what the message names"),
    ("kernel cache", _cache, f"set {CACHE_VARIABLE} or WRONGTURN_HOME to a directory that can be written"),
    ("kernels", _kernels, "reinstall numba in the version that constraints.txt names"),
    ("episode", _episode, "see the checks above; then install wrongturn-service and wrongturn-networks again"),
)


def checks() -> Iterator[Check]:
    """Yield the result of each check."""
    for name, check, remedy in _CHECKS:
        try:
            yield name, True, check(), ""
        except Exception as error:
            yield name, False, str(error) or type(error).__name__, remedy
