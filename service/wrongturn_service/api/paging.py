"""Lists by pages: ``limit`` items at a time, from a ``cursor`` on that the page before named."""

import binascii
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Final, TypeVar

from fastapi import Depends, Query

from wrongturn_service.errors import InvalidRequestError

R = TypeVar("R")
_MOST: Final = 500
_USUAL: Final = 100
_DIGITS: Final = 18
"""Digits of a number that databases hold."""


@dataclass(frozen=True)
class Wanted:
    """The page that a request asks for."""

    limit: int
    """Most items."""
    cursor: str | None
    """As the request names it. It is read once the list is, after the check of the caller's token."""

    @property
    def after(self) -> str | None:
        """What the last item of the page before is sorted by; None for the first page. Raises InvalidRequestError."""
        if self.cursor is None:
            return None
        try:
            after = urlsafe_b64decode(self.cursor.encode("ascii")).decode("ascii")
        except (UnicodeError, binascii.Error, ValueError):
            raise not_of_this_list() from None
        if not after or not after.isprintable() or _cursor(after) != self.cursor:
            raise not_of_this_list()
        return after

    @property
    def number(self) -> int | None:
        """The same as a number, in lists that are sorted by one. Raises InvalidRequestError."""
        after = self.after
        if after is None:
            return None
        if not after.isdecimal() or len(after) > _DIGITS:
            raise not_of_this_list()
        return int(after)

    def cut(self, rows: Sequence[R], key: Callable[[R], str | int | None]) -> tuple[Sequence[R], str | None]:
        """Return the rows of the page, and the cursor of the next one; None at the end.

        ``rows`` are one more than the limit if there are as many; ``key`` returns what a row is sorted by.
        """
        page = rows[: self.limit]
        return page, _cursor(str(key(page[-1]))) if len(rows) > self.limit else None


async def wanted(
    limit: Annotated[int, Query(ge=1, le=_MOST, description="Most items of the page")] = _USUAL,
    cursor: Annotated[
        str | None, Query(max_length=200, description="`next` of the page before; without it the first page")
    ] = None,
) -> Wanted:
    """Return the page that a request asks for."""
    return Wanted(limit, cursor)


PageDep = Annotated[Wanted, Depends(wanted)]


def _cursor(after: str) -> str:
    return urlsafe_b64encode(after.encode("ascii")).decode("ascii")


def not_of_this_list() -> InvalidRequestError:
    """Return the error of a cursor that the list did not make."""
    return InvalidRequestError("query.cursor", "is not a cursor of this list; leave it out to start at the beginning")
