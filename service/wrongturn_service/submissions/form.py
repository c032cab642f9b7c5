"""Reads a multipart form piece by piece: small fields into memory, the model into a sink. It knows no HTTP and no disk.

The same bytes give the same result however they are cut into pieces.
"""

import logging
import re
from collections.abc import Callable
from typing import Final

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_protocol.submissions import MODEL, NAME, SUITE
from wrongturn_service.errors import InvalidRequestError, ServiceError

FIELDS: Final = (MODEL, SUITE, NAME)
FIELD_LIMIT: Final = 1024
"""Bytes of a field that is not the model."""
AROUND: Final = 64 * 1024
"""Bytes of a body beside the model's."""
_HEADER_LIMIT: Final = 4096
_HEADERS: Final = 8
_SHOWN: Final = 64
_BOUNDARY: Final = re.compile(rb"[0-9A-Za-z'()+_,\-./:=? ]{0,69}[0-9A-Za-z'()+_,\-./:=?]")
"""RFC 2046, 5.1.1."""
_PLAIN: Final = {b"", b"binary", b"8bit", b"7bit"}
_EXAMPLE: Final = "send it as curl -F model=@agent.onnx -F suite=wrong-command@3 -F name=mine does"
# It would log a line for each malformed body, which anybody can send.
logging.getLogger("python_multipart").setLevel(logging.CRITICAL)


def boundary_of(content_type: str) -> bytes:
    """Return the boundary that a ``Content-Type`` header names.

    Raises ServiceError if the type is not ``multipart/form-data`` (415), or its boundary is missing or malformed (400).
    """
    media, options = parse_options_header(content_type[:_HEADER_LIMIT])
    if media != b"multipart/form-data":
        raise ServiceError(
            ProblemType.UNSUPPORTED_MEDIA_TYPE,
            f"the body's Content-Type has to be multipart/form-data; {_EXAMPLE}",
            status=415,
            headers={"Accept": "multipart/form-data"},
        )
    boundary = options.get(b"boundary", b"")
    if not _BOUNDARY.fullmatch(boundary):
        raise _malformed("its Content-Type has to name a boundary of 1 to 70 characters that RFC 2046 allows")
    return boundary


class Form:
    """A form that is being read. ``sink`` takes at most ``limit`` bytes of model; what it raises ends the reading."""

    def __init__(self, boundary: bytes, limit: int, sink: Callable[[bytes], None]) -> None:
        self.size = 0
        """Bytes of the model so far."""
        self._taken = 0
        self._limit = limit
        self._sink = sink
        self._delimiter = b"--" + boundary
        self._head: bytes | None = b""
        """What has come of the first delimiter; None once it was complete."""
        self._values: dict[str, bytearray] = {}
        self._field = ""
        self._headers: dict[bytes, bytes] = {}
        self._header = [b"", b""]
        self._ended = False
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin_part,
                "on_part_data": self._take,
                "on_header_field": lambda data, start, end: self._add_header(0, data[start:end]),
                "on_header_value": lambda data, start, end: self._add_header(1, data[start:end]),
                "on_header_end": self._end_header,
                "on_headers_finished": self._end_headers,
                "on_end": lambda: setattr(self, "_ended", True),
            },
            max_header_count=_HEADERS,
            max_header_size=_HEADER_LIMIT,
        )

    def feed(self, piece: bytes) -> None:
        """Read the next piece.

        Raises ServiceError if the body is malformed (400), the model is too large (413), or a field is wrong (422).
        """
        self._taken += len(piece)
        if self._taken > self._limit + AROUND:
            raise too_large(self._limit)
        if self._head is not None:
            # The parser skips what comes before the first delimiter, but not always.
            self._head += piece
            if len(self._head) < len(self._delimiter) and self._delimiter.startswith(self._head):
                return
            if not self._head.startswith(self._delimiter):
                raise _malformed("it does not begin with the boundary that its Content-Type names")
            piece, self._head = self._head, None
        try:
            self._parser.write(piece)
        except FormParserError as error:
            raise _malformed(f"it breaks the rules of RFC 7578; {_EXAMPLE}") from error

    def end(self) -> dict[str, str]:
        """Return the values of the fields beside the model.

        Raises ServiceError if the body ended too early (400), or a field is missing or wrong (422).
        """
        if not self._ended:
            raise _malformed("it ends before its final boundary; send it again")
        missing = [name for name in (MODEL, SUITE) if name not in self._values]
        if missing:
            errors = [FieldError(path=name, message="is missing") for name in missing]
            raise ServiceError(
                ProblemType.VALIDATION,
                f"{' and '.join(missing)}: missing in the form; {_EXAMPLE}",
                status=422,
                errors=errors,
            )
        if not self.size:
            raise InvalidRequestError(MODEL, "is empty; send an ONNX file")
        return self.fields()

    def fields(self) -> dict[str, str]:
        """Return the values that have come of the fields beside the model. Raises ServiceError if one is no text."""
        return {name: _text(name, value) for name, value in self._values.items() if name != MODEL}

    def _begin_part(self) -> None:
        self._headers, self._header = {}, [b"", b""]

    def _add_header(self, at: int, part: bytes) -> None:
        self._header[at] += part

    def _end_header(self) -> None:
        name, value = self._header
        self._headers[name.lower()] = value.strip()
        self._header = [b"", b""]

    def _end_headers(self) -> None:
        kind, options = parse_options_header(self._headers.get(b"content-disposition", b""))
        if kind != b"form-data" or b"name" not in options:
            raise _malformed("a part has no Content-Disposition: form-data with a name")
        name = options[b"name"].decode("utf-8", "replace")
        if name not in FIELDS:
            shown = "".join(character if character.isprintable() else "?" for character in name[:_SHOWN])
            raise InvalidRequestError(shown or "body", f"is no field of this form; send {', '.join(FIELDS)}")
        if name in self._values:
            raise InvalidRequestError(name, "is sent more than once; send each field once")
        if self._headers.get(b"content-transfer-encoding", b"").lower() not in _PLAIN:
            raise InvalidRequestError(name, "has a Content-Transfer-Encoding; send the bytes as they are")
        self._field = name
        self._values[name] = bytearray()

    def _take(self, data: bytes, start: int, end: int) -> None:
        if self._field == MODEL:
            self.size += end - start
            if self.size > self._limit:
                raise too_large(self._limit)
            self._sink(data[start:end])
            return
        value = self._values[self._field]
        value += data[start:end]
        if len(value) > FIELD_LIMIT:
            raise InvalidRequestError(self._field, f"is longer than {FIELD_LIMIT} bytes")


def too_large(limit: int) -> ServiceError:
    """Return the error for a model that is too large."""
    return ServiceError(
        ProblemType.BODY_TOO_LARGE,
        f"model: is larger than {limit} bytes, the limit of this service",
        status=413,
        errors=[FieldError(path=MODEL, message=f"is larger than {limit} bytes")],
    )


def _malformed(reason: str) -> ServiceError:
    return ServiceError(ProblemType.MALFORMED_BODY, f"the body is no form: {reason}", status=400)


def _text(name: str, value: bytearray) -> str:
    try:
        return value.decode()
    except UnicodeDecodeError:
        raise InvalidRequestError(name, "is not UTF-8 text") from None
