"""Replies with an ETag: a caller that has the same bytes already gets 304."""

import hashlib
from collections.abc import Mapping

from fastapi import Request, Response


def reply(
    request: Request, body: bytes, media_type: str, headers: Mapping[str, str], *, status: int = 200, tag: str = ""
) -> Response:
    """Return the reply with a body; 304, with the same headers, if the status is 200 and the caller has it already.

    ``tag`` is the body's ETag, if it is known already.
    """
    tag = tag or f'"{hashlib.sha256(body).hexdigest()[:32]}"'
    named = {**headers, "ETag": tag}
    # If-None-Match names tags alone, in a list, as weak ones, or by ``*``.
    there = {part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")}
    if status == 200 and not there.isdisjoint({tag, "*"}):
        return Response(status_code=304, headers=named)
    return Response(body, status, named, media_type)
