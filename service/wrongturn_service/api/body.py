"""Bodies of requests: read with limits and parsed strictly. Errors name the field."""

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from functools import lru_cache
from typing import TypeVar

import msgpack
from fastapi import Request
from pydantic import BaseModel, ValidationError

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.encoding import Encoding
from wrongturn_service.errors import ServiceError
from wrongturn_service.socket.guards import PROGRESS

M = TypeVar("M", bound=BaseModel)
_SHOWN = 50
_LISTED = 200
"""Errors of a message beyond which they are only counted: to list a million takes 20 s."""
_ITEMS = 64
"""Most items of an array or a map of msgpack. The library makes room for as many as an array claims to have."""
_LONGEST = 200
_UNION_LABELS = frozenset({"Fault", "str-enum[FaultKind]"})


async def parsed(request: Request, model: type[M], *, limit: int, binary: bool = False) -> M:
    """Read a request's body of at most ``limit`` bytes as a message; ``binary`` says whether msgpack is accepted too.

    Pydantic parses and checks JSON in one pass. It reads NaN and Infinity as numbers that are not finite, so the error
    names their field.

    Raises:
        ServiceError: The body is too large (413), of another type or compressed (415), malformed (400), or invalid
            (422).
    """
    encoding = _media(request.headers.get("content-type", ""))
    if encoding is None or (encoding is Encoding.MSGPACK and not binary):
        taken = "application/json" + (" or application/msgpack" if binary else "")
        raise ServiceError(
            ProblemType.UNSUPPORTED_MEDIA_TYPE,
            f"the body's Content-Type has to be {taken}",
            status=415,
            headers={"Accept": taken.replace(" or ", ", ")},
        )
    if "content-encoding" in request.headers:
        check_uncompressed(request.headers.getlist("content-encoding"))
    body = await _read(request, limit)
    try:
        return model.model_validate_json(body if encoding is Encoding.JSON else _as_json(body), strict=True)
    except ValidationError as error:
        raise refused(error) from error


async def _read(request: Request, limit: int) -> bytes:
    length = request.headers.get("content-length", "")
    if length.isdecimal() and int(length[:20]) > limit:
        raise _too_large(limit)
    pieces = bytearray()
    async for piece in in_time(request.stream(), request.app.state.service.settings.slow_client_s):
        pieces += piece
        if len(pieces) > limit:
            raise _too_large(limit)
    return bytes(pieces)


async def in_time(body: AsyncIterator[bytes], patience_s: float) -> AsyncIterator[bytes]:
    """Yield the pieces of a body. Only waiting for the client counts, not what is done with a piece.

    Raises ServiceError (408) if the client sends less than :data:`PROGRESS` bytes within the time.
    """
    loop = asyncio.get_running_loop()
    left, moved = patience_s, 0
    while True:
        began = loop.time()
        try:
            async with asyncio.timeout(left):
                piece = await anext(body, None)
        except TimeoutError:
            raise ServiceError(
                ProblemType.REQUEST_TIMEOUT,
                f"the body came too slowly: {PROGRESS} bytes have to come within {patience_s:g} s",
                status=408,
                headers={"Connection": "close"},
            ) from None
        if piece is None:
            return
        left -= loop.time() - began
        moved += len(piece)
        if moved >= PROGRESS:
            left, moved = patience_s, 0
        yield piece


def _too_large(limit: int) -> ServiceError:
    detail = f"the body is larger than {limit} bytes, which is the limit of this call; send less"
    return ServiceError(ProblemType.BODY_TOO_LARGE, detail, status=413, headers={"Connection": "close"})


def check_uncompressed(encodings: Sequence[str]) -> None:
    """Check the values of a request's ``Content-Encoding``. Raises ServiceError (415)."""
    if any(encoding.strip().lower() not in {"", "identity"} for encoding in encodings):
        raise ServiceError(
            ProblemType.UNSUPPORTED_MEDIA_TYPE,
            "the body has a Content-Encoding; send it as it is, without compression and without that header",
            status=415,
            headers={"Accept-Encoding": "identity"},
        )


@lru_cache(maxsize=256)
def _media(content_type: str) -> Encoding | None:
    media = content_type.partition(";")[0].strip().lower()
    if media in {"", "application/json"} or (media.startswith("application/") and media.endswith("+json")):
        return Encoding.JSON
    return Encoding.MSGPACK if media in {"application/msgpack", "application/x-msgpack"} else None


def _as_json(body: bytes) -> str:
    """Return a msgpack body as JSON, so that both are checked alike. NaN stays NaN."""
    try:
        return json.dumps(msgpack.unpackb(body, max_array_len=_ITEMS, max_map_len=_ITEMS, max_ext_len=0))
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:
        reason = str(error) or type(error).__name__
        raise malformed(f"the body is not msgpack: {reason[:_LONGEST]}") from error


def malformed(detail: str) -> ServiceError:
    """Return the error for a body that cannot be parsed."""
    return ServiceError(ProblemType.MALFORMED_BODY, detail, status=400)


def refused(error: ValidationError) -> ServiceError:
    """Return the error for a message with wrong fields."""
    if error.error_count() > _LISTED:
        field = FieldError(path="body", message=f"has {error.error_count()} errors; /openapi.json has its fields")
        return ServiceError(ProblemType.VALIDATION, f"body: {field.message}", status=422, errors=[field])
    # The error never repeats the input, which may be large, secret, or not valid JSON.
    found = error.errors(include_url=False, include_context=False, include_input=False)
    if found and found[0]["type"] == "json_invalid":
        return malformed(f"the body is not JSON: {found[0]['msg'].removeprefix('Invalid JSON: ')}")
    errors: list[FieldError] = []
    for item in found[:_SHOWN]:
        path = ".".join(str(part) for part in item["loc"] if part not in _UNION_LABELS) or "body"
        message = item["msg"].removeprefix("Value error, ")
        field = FieldError(path=_printable(path), message=message[:_LONGEST])
        if field not in errors:
            errors.append(field)
    detail = "; ".join(f"{field.path}: {field.message}" for field in errors[:3])
    return ServiceError(ProblemType.VALIDATION, detail, status=422, errors=errors)


def _printable(path: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in path[:_LONGEST])
