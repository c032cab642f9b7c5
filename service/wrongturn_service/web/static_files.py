"""The pages' scripts, styles and pictures."""

from typing import Final

from fastapi import APIRouter, Request, Response
from starlette.staticfiles import StaticFiles

from wrongturn_service.web.page import SECURITY

router = APIRouter(include_in_schema=False)
_FILES: Final = StaticFiles(packages=[("wrongturn_service.web", "static")])


@router.api_route("/static/{file:path}", methods=["GET", "HEAD"])
async def static(request: Request, file: str) -> Response:
    """Send a file. Only the files that the package holds can be named."""
    response = await _FILES.get_response(file, request.scope)
    response.headers.update({**SECURITY, "Cache-Control": "no-cache"})
    return response
