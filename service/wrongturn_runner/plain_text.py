"""Text from a model, made safe to show."""

from typing import Final

_LONGEST: Final = 500
"""Characters; a reason is a sentence or two."""


def plain(text: str, longest: int = _LONGEST) -> str:
    """Return text of strangers in one line of printable characters, cut to a length.

    Args:
        text: The text, such as a tensor's name or a message of onnxruntime about it.
        longest: Most characters.
    """
    # Cut first, so that a long text costs nothing. A line break and its like are spaces.
    spaced = " ".join(text[: 4 * longest].split())
    shown = "".join(letter if letter.isprintable() else "?" for letter in spaced)
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"
