"""Error pages, for browsers that ask for a page."""

from typing import Final
from urllib.parse import quote

from fastapi import Request, Response
from fastapi.responses import RedirectResponse
from starlette.routing import Match

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.errors import ServiceError, title
from wrongturn_service.web.page import page

_CALLS: Final = ("/v1/", "/health/", "/metrics", "/openapi.json", "/problems/", "/static/")
"""Paths whose errors are always problems in JSON."""
_PAGES: Final = ("text/html", "application/xhtml+xml", "text/*")
"""What only a browser accepts."""
_HEADINGS: Final = {
    ProblemType.UNKNOWN_ROUTE: "There is no such page",
    ProblemType.VALIDATION: "The address asks for something that this page does not have",
    ProblemType.INTERNAL: "Something went wrong",
}
"""Headings where a problem's title would tell a reader of pages little."""
_QUERY: Final = "query."


def wants_page(request: Request) -> bool:
    """Return whether an error is shown as a page: a browser asked for one of the pages."""
    accepted = request.headers.get("accept", "").lower()
    return _is_of_pages(request) and any(kind in accepted for kind in _PAGES)


def page_without_slash(request: Request) -> Response | None:
    """Return the way to the page that a path with a slash at its end means; None if there is none."""
    path = request.scope["path"]
    wanted = path.rstrip("/")
    if wanted == path or not _is_of_pages(request):
        return None
    scope = {**request.scope, "path": wanted}
    if not any(route.matches(scope)[0] is Match.FULL for route in request.app.routes):
        return None
    query = request.url.query
    # Relative, as the pages' links are.
    up = "../" * (path.count("/") - wanted.count("/"))
    return RedirectResponse(up + quote(wanted.rpartition("/")[2], safe="@") + (f"?{query}" if query else ""), 308)


def error_page(request: Request, error: ServiceError) -> Response:
    """Return the page of an error."""
    unknown = request.scope.get("endpoint") is None
    response = page(
        request,
        "error.html",
        status=error.status,
        heading=_HEADINGS.get(error.kind) or title(error.kind),
        # Without a route the problem's text speaks of calls.
        detail="Nothing is at this address. It may have a typing error"
        if unknown
        else error.detail[:1].upper() + error.detail[1:],
        fields=[_field(field) for field in error.errors],
    )
    response.headers.update(error.headers)
    return response


def _is_of_pages(request: Request) -> bool:
    return request.method in {"GET", "HEAD"} and not request.scope["path"].startswith(_CALLS)


def _field(field: FieldError) -> tuple[str, str]:
    """Return a field's name in the address, and what is wrong with it."""
    return field.path.removeprefix(_QUERY), field.message.removeprefix("String ").removeprefix("Input ")
