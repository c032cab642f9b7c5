"""The pages' scripts, styles and pictures."""

import mimetypes
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final

from fastapi import APIRouter, Request, Response

from wrongturn_protocol import ProblemType
from wrongturn_service import unchanged
from wrongturn_service.errors import ServiceError
from wrongturn_service.web.page import SECURITY

router = APIRouter(include_in_schema=False)
_TYPES: Final = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}


@router.api_route("/static/{file:path}", methods=["GET", "HEAD"])
async def static(request: Request, file: str) -> Response:
    """Send a file. Only the files that the package holds can be named."""
    found = _files().get(file)
    if found is None:
        raise ServiceError(ProblemType.UNKNOWN_ROUTE, f"there is no file {file[:64]!r}", status=404)
    body, kind, tag = found
    return unchanged.reply(request, body, kind, {**SECURITY, "Cache-Control": "no-cache"}, tag=tag)


@cache
def _files() -> dict[str, tuple[bytes, str, str]]:
    """Return each file's content, media type and ETag, by its path below ``static``."""
    found = {}
    folders: list[tuple[str, Traversable]] = [("", files("wrongturn_service.web") / "static")]
    for prefix, folder in folders:
        for item in folder.iterdir():
            name = f"{prefix}{item.name}"
            if item.is_dir():
                folders.append((f"{name}/", item))
                continue
            body = item.read_bytes()
            suffix = name[name.rfind(".") :]
            kind = _TYPES.get(suffix) or mimetypes.guess_type(name)[0] or "text/plain"
            found[name] = (body, kind, unchanged.tag_of(body))
    return found
