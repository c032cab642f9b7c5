"""Error pages, for browsers that ask for a page."""

from typing import Final

from fastapi import Request, Response

from wrongturn_service.errors import ServiceError, title
from wrongturn_service.web.page import page

_CALLS: Final = ("/v1/", "/health/", "/metrics", "/openapi.json", "/problems/", "/static/")
"""Paths whose errors are always problems in JSON."""


def wants_page(request: Request) -> bool:
    """Return whether an error is shown as a page: a browser asked for one of the pages."""
    return (
        request.method in {"GET", "HEAD"}
        and not request.url.path.startswith(_CALLS)
        and "text/html" in request.headers.get("accept", "")
    )


def error_page(request: Request, error: ServiceError) -> Response:
    """Return the page of an error."""
    response = page(request, "error.html", status=error.status, heading=title(error.kind), detail=error.detail)
    response.headers.update(error.headers)
    return response
