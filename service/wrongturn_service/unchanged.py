"""Replies with an ETag: a caller that has the same bytes already gets 304."""

import hashlib
from collections.abc import Mapping
from typing import Final

from fastapi import Request, Response

_WEAK: Final = "W/"


def tag_of(body: bytes) -> str:
    """Return the ETag of a body, with its quotes."""
    return f'"{hashlib.sha256(body).hexdigest()[:32]}"'


def has_already(request: Request, tag: str) -> bool:
    """Return whether the caller's ``If-None-Match`` names a tag: alone, in a list, as a weak one, or by ``*``."""
    named = {part.strip().removeprefix(_WEAK) for part in request.headers.get("if-none-match", "").split(",")}
    return not named.isdisjoint({tag, "*"})


def reply(
    request: Request, body: bytes, media_type: str, headers: Mapping[str, str], *, status: int = 200, tag: str = ""
) -> Response:
    """Return the reply with a body; 304 if the caller has it already.

    Args:
        request: The request.
        body: What is sent.
        media_type: Media type of the body.
        headers: Other headers. A 304 has them too.
        status: Status of the reply. Only 200 becomes 304.
        tag: ETag of the body, if it is known already.
    """
    tag = tag or tag_of(body)
    named = {**headers, "ETag": tag}
    if status == 200 and has_already(request, tag):
        return Response(status_code=304, headers=named)
    return Response(body, status, named, media_type)
