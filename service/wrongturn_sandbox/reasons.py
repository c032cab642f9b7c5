"""Turns what a guest says, and how it ended, into a sentence for the model's owner."""

import re
import signal
from typing import Final

from wrongturn_sandbox.messages import Limits

REASON_MOST: Final = 400
"""Longest reason, characters."""
_SOURCE: Final = re.compile(r"(?:[\w.+-]*/)+[\w.+-]+\.(?:cc|cpp|h|hpp|py|so|pyx)\b(?::\d+)?|\w+\.(?:cc|cpp|h|hpp):\d+")
_RUNTIME: Final = re.compile(r"^\[ONNXRuntimeError\] : \d+ : [A-Z_]+ : ")
_PREFIX: Final = re.compile(r"^(?:Exception during (?:initialization|loading): ?|Load model from .{0,200}? failed:)")
_NODE: Final = re.compile(r"^Non-zero status code returned while running (\w+) node\. Name:'([^']*)' Status Message: ")
_FUNCTION: Final = re.compile(r"^ (?:[^()]{1,200}\([^()]*\)(?: const)?(?: \[with [^\]]*\])?|\w+) ")
FROM_OUTSIDE: Final = frozenset(
    {signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGSTOP}
)
"""Signals that end a guest from outside. The kernel sends none of them for what a guest does within its limits."""


def printable(text: object, most: int = REASON_MOST) -> str:
    """Return a stranger's words as one line of printable characters, cut to a length."""
    words = text[: 16 * most] if isinstance(text, str) else "no reason given"
    words = " ".join("".join(letter if letter.isprintable() else " " for letter in words).split())
    return words if len(words) <= most else words[: most - 1].rstrip() + "…"


def runtime_error(error: BaseException) -> str:
    """Return onnxruntime's message without the places in its own source code."""
    words = _PREFIX.sub("", _RUNTIME.sub("", str(error)))
    words = _NODE.sub(r"node '\2' (\1): ", words)
    if (match := _SOURCE.search(words)) is not None:
        words = words[: match.start()] + _FUNCTION.sub("", words[match.end() :])
    return printable(_SOURCE.sub("", words[: 16 * REASON_MOST]).strip(" :"))


def out_of_memory(limits: Limits) -> str:
    """Return the reason of a model that takes too much memory."""
    return f"the model needs more than the {limits.memory >> 20} MiB of memory that a model gets; make it smaller"


def ending(status: int | None, limits: Limits) -> str | None:
    """Return why a guest is to blame for its end, or None when it was ended from outside.

    Its exit status is negative for a signal, and None where nobody knows.
    """
    if status is None:
        return None
    if status >= 0:
        return f"the model ended its sandbox by itself (status {status})"
    if -status in FROM_OUTSIDE:
        return None
    if -status == signal.SIGXCPU:
        return (
            "the model used more processor time than it may "
            f"({limits.load_s:g} s to load, {limits.step_s:g} s a step); make it smaller or simpler"
        )
    try:
        name = signal.Signals(-status).name
    except ValueError:
        name = f"signal {-status}"
    hint = (
        f", perhaps because it needs more than {limits.memory >> 20} MiB of memory" if -status == signal.SIGABRT else ""
    )
    return f"the model crashes onnxruntime ({name}){hint}; check that it runs with onnxruntime on your machine"
