"""A step as nearly every one comes: nothing about it is to be explained, only done."""

from typing import Any, Final, NamedTuple

from wrongturn_service.pool.actions import Action, rounded

_NUMBERS: Final = {float, int}
"""Some clients' languages know no other zero than the integer."""


class PlainStep(NamedTuple):
    """A step that asks for nothing but that."""

    episode: str
    seq: int
    action: Action


def plain_step(call: Any) -> PlainStep | None:
    """A call of ``WS /v1/drive`` as a step; None for any other, and for one with which something is wrong.

    Args:
        call: any of a message's.
    """
    if type(call) is not list or len(call) != 6 or call[0] != "step":
        return None
    _, episode, seq, steer, throttle, brake = call
    if type(episode) is not str or type(seq) is not int:
        return None
    if not type(steer) is type(throttle) is type(brake) is float and not {*map(type, call[3:])} <= _NUMBERS:
        return None
    if not (-1.0 <= steer <= 1.0 and 0.0 <= throttle <= 1.0 and 0.0 <= brake <= 1.0):
        return None
    return PlainStep(episode, seq, rounded(steer, throttle, brake))
