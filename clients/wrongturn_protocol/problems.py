"""The error reply."""

from typing import Annotated

from pydantic import Field

from wrongturn_protocol.episodes import Message, is_none


class FieldError(Message):
    """Error in one field of a request."""

    path: str
    """Path of the field, such as ``action.steer``."""
    message: str


class Problem(Message):
    """Error reply, ``application/problem+json`` (RFC 9457)."""

    type: str
    """``/problems/`` and a :class:`~wrongturn_protocol.vocabulary.ProblemType`; that page explains it."""
    title: str
    status: int
    detail: str
    errors: tuple[FieldError, ...] = ()
    position: Annotated[int, Field(ge=1)] | None = Field(default=None, exclude_if=is_none)
    """Position in the queue, with 429 and 503: 1 means that it is your turn when the next place is free.

    The queue is the one for simulators, where your place is kept if you come back after ``Retry-After``; or your own,
    if you met a limit of your own.
    """
