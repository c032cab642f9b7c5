"""Pages: Jinja templates, sent with a strict Content-Security-Policy."""

from functools import cache
from typing import Any, Final

from fastapi import Request, Response
from jinja2 import Environment, PackageLoader, StrictUndefined

from wrongturn_service import unchanged
from wrongturn_service.errors import InvalidRequestError

SECURITY: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every page. Nothing comes from another origin, and no script or style is inline."""


@cache
def templates() -> Environment:
    """Return the environment of the templates. It escapes everything and refuses unknown names."""
    return Environment(
        loader=PackageLoader("wrongturn_service.web"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def page(request: Request, template: str, *, status: int = 200, **values: Any) -> Response:
    """Return a page.

    A browser that has the same page already gets 304.

    Args:
        request: The request.
        template: File name of the template.
        status: Status of the response.
        values: The template's variables.
    """
    path = request.url.path
    return sent(request, templates().get_template(template).render(path=path, **values).encode(), status)


def numbered_page(number: str, count: int) -> int:
    """Return the page of a list that an address names. Raises InvalidRequestError.

    Args:
        number: What the address says.
        count: Number of pages.
    """
    if number.isascii() and number.isdigit() and 1 <= int(number) <= count:
        return int(number)
    raise InvalidRequestError("query.page", f"is {number!r}; give a number from 1 to {count}")


def sent(request: Request, body: bytes, status: int = 200) -> Response:
    """Return the response with a page that is rendered already, see :func:`page`."""
    headers = {**SECURITY, "Cache-Control": "no-cache"}
    return unchanged.reply(request, body, "text/html; charset=utf-8", headers, status=status)
