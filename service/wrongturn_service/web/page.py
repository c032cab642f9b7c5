"""Pages: Jinja templates and static files, sent with a strict Content-Security-Policy."""

from functools import cache
from importlib.metadata import metadata
from importlib.resources import files
from typing import Any, Final

from fastapi import APIRouter, Request, Response
from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.staticfiles import StaticFiles

from wrongturn_service.api.dependencies import tagged
from wrongturn_service.errors import InvalidRequestError

router = APIRouter(include_in_schema=False)
_STATIC: Final = StaticFiles(packages=[("wrongturn_service.web", "static")])
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
    environment = Environment(
        loader=PackageLoader("wrongturn_service.web"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["project_links"] = project_links
    return environment


@cache
def project_links() -> list[tuple[str, str]]:
    """Return names and addresses of the project's own pages, such as its repository, as its package declares them."""
    declared = metadata("wrongturn-service").get_all("Project-URL") or []
    return [(name.strip(), url.strip()) for name, _, url in (one.partition(",") for one in declared)]


@router.api_route("/about", methods=["GET", "HEAD"])
async def about(request: Request) -> Response:
    """Show the paper, the licence, and how to cite."""
    return page(request, "about.html", bibtex=(files("wrongturn_service.web") / "citation.bib").read_text("utf-8"))


def page(request: Request, template: str, *, status: int = 200, **values: Any) -> Response:
    """Return a page, see :func:`rendered`. A browser that has the same page already gets 304."""
    raw: bytes = request.scope.get("raw_path") or request.url.path.encode()
    values.setdefault("root", root_of(raw.decode("ascii", "replace")))
    return sent(request, rendered(template, request.url.path, **values), status)


def rendered(template: str, path: str, **values: Any) -> bytes:
    """Return a page's HTML.

    The template gets the values, ``path`` (such as ``/suites/smoke@3``), and ``root``, with which all its links begin.
    """
    return templates().get_template(template).render({"path": path, "root": root_of(path), **values}).encode()


def public_url(request: Request) -> str:
    """Return the URL at which people reach this service, without a slash at its end."""
    told: str | None = request.app.state.service.settings.public_url
    return told or str(request.base_url).rstrip("/")


def root_of(path: str) -> str:
    """Return the way from a page to the service's root, without a slash at its end: ``.`` or ``..`` or ``../..``.

    Links are relative, so that they also work behind a proxy that serves the service below a path of its own.
    """
    return "/".join([".."] * (path.count("/") - 1)) or "."


def numbered_page(number: str, count: int) -> int:
    """Return the page of a list that an address names. Raises InvalidRequestError."""
    if number.isascii() and number.isdigit() and 1 <= int(number) <= count:
        return int(number)
    raise InvalidRequestError("query.page", f"is {number!r}; give a number from 1 to {count}")


def sent(request: Request, body: bytes, status: int = 200) -> Response:
    """Return the response with a page that is rendered already, see :func:`page`."""
    headers = {**SECURITY, "Cache-Control": "no-cache"}
    return tagged(request, body, "text/html; charset=utf-8", headers, status=status)


@router.api_route("/static/{file:path}", methods=["GET", "HEAD"])
async def static(request: Request, file: str) -> Response:
    """Send a script, a style or a picture. Only the files that the package holds can be named."""
    response = await _STATIC.get_response(file, request.scope)
    response.headers.update({**SECURITY, "Cache-Control": "no-cache"})
    return response
