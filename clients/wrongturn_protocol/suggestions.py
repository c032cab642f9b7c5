"""The known name that a user may have meant by an unknown one."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """Return ``. Did you mean Town01?`` to end an error with; empty if no known name is near, or none was given."""
    if not isinstance(given, str):
        return ""
    names = {name.lower(): name for name in known}
    near = get_close_matches(given.lower(), names, n=1)
    return f". Did you mean {names[near[0]]}?" if near else ""
