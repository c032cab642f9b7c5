"""How a runner ends before its work is done.

These are no ``Exception``: the client aborts the episode of a policy that raises one, and an aborted episode counts.
The service decides what becomes of open episodes. It closes the evaluation of a refused model, and drives again what
a lost sandbox left open.
"""

from typing import Final

_LONGEST: Final = 500
"""Characters; a reason is a sentence or two."""


class ModelAtFaultError(BaseException):
    """The model cannot be driven. The message tells its owner what is wrong and what to do."""


class RunnerFailedError(BaseException):
    """Something else than the model has failed. The service starts another runner."""


class NoRoomError(RunnerFailedError):
    """All sandboxes are taken. The service starts another runner later."""


def plain(text: str, longest: int = _LONGEST) -> str:
    """Return a stranger's text, such as a tensor's name, as one line of printable characters, cut to a length."""
    # Cut first, so that a long text costs nothing. A line break and its like are spaces.
    spaced = " ".join(text[: 4 * longest].split())
    shown = "".join(letter if letter.isprintable() else "?" for letter in spaced)
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"
