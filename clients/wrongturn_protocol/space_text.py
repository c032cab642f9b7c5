"""The text of a Gymnasium space in an error. Gymnasium's own prints every bound, which may be hundreds of lines."""

from typing import Any, Final

from gymnasium import spaces

_LONGEST: Final = 100


def in_short(space: spaces.Space[Any]) -> str:
    """Return a space in one line. A ``Box`` of many bounds shows the least and the greatest, a ``Dict`` its keys."""
    text = str(space)
    if len(text) <= _LONGEST and "\n" not in text:
        return text
    if isinstance(space, spaces.Box):
        return f"Box({space.low.min()} to {space.high.max()}, {space.shape}, {space.dtype})"
    if isinstance(space, spaces.Dict):
        return f"Dict of {', '.join(map(str, space))}"
    return f"{' '.join(text.split())[:_LONGEST]}…"
