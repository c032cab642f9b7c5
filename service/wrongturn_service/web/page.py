"""Pages: Jinja templates, sent with a strict Content-Security-Policy."""

import hashlib
from functools import cache
from typing import Any, Final

from fastapi import Request, Response
from jinja2 import Environment, PackageLoader, StrictUndefined

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


def sent(request: Request, body: bytes, status: int = 200) -> Response:
    """Return the response with a page that is rendered already, see :func:`page`."""
    headers = {**SECURITY, "Cache-Control": "no-cache", "ETag": f'"{hashlib.sha256(body).hexdigest()[:32]}"'}
    if status == 200 and request.headers.get("if-none-match") == headers["ETag"]:
        return Response(status_code=304, headers=headers)
    return Response(body, status, headers, "text/html; charset=utf-8")
