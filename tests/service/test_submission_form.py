"""The reader of multipart forms: what it takes and refuses, however the bytes are cut into pieces."""

import itertools
from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_form import BOUNDARY, TYPE, form, model, part

from wrongturn_service.errors import ServiceError
from wrongturn_service.submissions.form import FIELD_LIMIT, Form, boundary_of

LIMIT = 4096
Result = tuple[bytes, dict[str, str]] | tuple[int, str, str, tuple[str, ...]]


def read(pieces: Iterable[bytes], boundary: str = BOUNDARY, limit: int = LIMIT) -> Result:
    """The model and the fields; or the refusal's status, type, detail and paths."""
    taken = bytearray()
    try:
        reader = Form(boundary.encode(), limit, taken.extend)
        for piece in pieces:
            reader.feed(piece)
        fields = reader.end()
    except ServiceError as error:
        return error.status, error.kind.value, error.detail, tuple(field.path for field in error.errors)
    assert reader.size == len(taken)
    return bytes(taken), fields


def refusal(body: bytes, **more: int) -> tuple[int, tuple[str, ...]]:
    found = read([body], **more)  # type: ignore[arg-type]
    assert isinstance(found[0], int), found
    return found[0], found[3]  # type: ignore[misc]


def test_a_form_is_read() -> None:
    assert read([model(b"\r\n--a-boundar\0\xff")]) == (b"\r\n--a-boundar\0\xff", {"suite": "smoke@3", "name": "mine"})


@pytest.mark.parametrize(
    ("body", "status", "paths"),
    [
        (form(part("suite", b"s")), 422, ("model",)),
        (form(part("name", b"s")), 422, ("model", "suite")),
        (form(), 422, ("model", "suite")),
        (form(part("suite", b"s"), part("model", b"")), 422, ("model",)),
        (form(part("suite", b"s"), part("suite", b"s"), part("model", b"m")), 422, ("suite",)),
        (form(part("model", b"m"), part("model", b"m"), part("suite", b"s")), 422, ("model",)),
        (form(part("suite", b"s"), part("model", b"m"), part("extra", b"m")), 422, ("extra",)),
        (form(part("../../etc", b"s")), 422, ("../../etc",)),
        (form(part("\x07" * 200, b"s")), 422, ("?" * 64,)),
        (form(part("", b"s")), 422, ("body",)),
        (form(part("suite", b"s" * (FIELD_LIMIT + 1))), 422, ("suite",)),
        (form(part("suite", b"\xff"), part("model", b"m")), 422, ("suite",)),
        (form(part("model", b"m", "Content-Transfer-Encoding: base64\r\n")), 422, ("model",)),
        (form(part("model", b"m" * (LIMIT + 1))), 413, ("model",)),
        (form(part("model", b"m")) + b"x" * (LIMIT + 65536), 413, ("model",)),
        (form(part("model", b"m", disposition="attachment; name=model")), 400, ()),
        (form(part("model", b"m", disposition="form-data")), 400, ()),
        (f"--{BOUNDARY}\r\n\r\nvalue\r\n--{BOUNDARY}--\r\n".encode(), 400, ()),
        (form(part("model", b"m", "X: " + "y" * 5000 + "\r\n")), 400, ()),
        (form(part("model", b"m", "".join(f"X{n}: y\r\n" for n in range(20)))), 400, ()),
        (form(part("model", b"m", "No colon\r\n")), 400, ()),
        (model()[:-4], 400, ()),
        (model()[:-30], 400, ()),
        (model().replace(b"--a-boundary--", b"--a-boundary"), 400, ()),
        (b"", 400, ()),
        (b"preamble\r\n" + model(), 400, ()),
        (b"\r\n" + model(), 400, ()),
        (b'{"suite": "smoke@3"}', 400, ()),
        (model().replace(b"a-boundary", b"another"), 400, ()),
    ],
)
def test_what_is_wrong_is_named(body: bytes, status: int, paths: tuple[str, ...]) -> None:
    assert refusal(body) == (status, paths)


def test_a_model_of_the_largest_size() -> None:
    assert read([model(b"m" * LIMIT)])[0] == b"m" * LIMIT


@pytest.mark.parametrize(
    ("content_type", "status"),
    [
        ("", 415),
        ("application/json", 415),
        ("multipart/mixed; boundary=x", 415),
        ("application/x-www-form-urlencoded", 415),
        ("multipart/form-data", 400),
        ("multipart/form-data; boundary=", 400),
        ('multipart/form-data; boundary=""', 400),
        (f"multipart/form-data; boundary={'x' * 71}", 400),
        ('multipart/form-data; boundary="x "', 400),
        ('multipart/form-data; boundary="x\x01y"', 400),
        ("multipart/form-data; boundary=\xe9", 400),
        ("multipart/form-data; " + "x" * 100_000 + "; boundary=y", 400),
    ],
)
def test_a_content_type_that_is_wrong(content_type: str, status: int) -> None:
    with pytest.raises(ServiceError) as caught:
        boundary_of(content_type)
    assert caught.value.status == status


@pytest.mark.parametrize(
    ("content_type", "boundary"),
    [(TYPE, b"a-boundary"), ('Multipart/Form-Data; charset=utf-8; boundary="a b"', b"a b")],
)
def test_a_boundary_is_found(content_type: str, boundary: bytes) -> None:
    assert boundary_of(content_type) == boundary


def test_a_file_name_means_nothing() -> None:
    for name in ("../../../etc/passwd", "/etc/passwd", "C:\\x", 'a\\"; name=\\"suite', "\0", "x" * 2000, ""):
        body = form(part("suite", b"s"), part("model", b"m", disposition=f'form-data; name="model"; filename="{name}"'))
        assert read([body]) == (b"m", {"suite": "s"})


# Bytes that look like the boundary, or a part of it, are the hard ones.
pieces_of_a_model = st.lists(
    st.sampled_from(
        [b"\r", b"\n", b"-", b"--", b"\r\n", b"--a-boundary", b"\r\n--a-boundar", b"\r\n--a-boundaryx", b"a"]
    )
    | st.binary(max_size=20),
    max_size=12,
).map(b"".join)
pieces_of_a_body = st.lists(
    st.sampled_from([b"\r\n--a-boundary", b"--a-boundary", b"--a-boundary--", b"\r\n", b"\r", b": ", b"-", b" "])
    | st.sampled_from(
        [b"Content-Disposition: form-data; name=", b"model", b'"suite"', b"name", b"\r\n\r\n", b"a-bound"]
    )
    | st.binary(max_size=4),
    max_size=25,
).map(b"".join)


def cut(body: bytes, at: Iterable[int]) -> list[bytes]:
    edges = sorted({0, len(body), *(place % (len(body) + 1) for place in at)})
    return [body[begin:end] for begin, end in itertools.pairwise(edges)]


places = st.lists(st.integers(0, 100_000), max_size=40)


@settings(max_examples=300)
@given(value=pieces_of_a_model, at=places)
def test_the_model_is_what_was_sent_however_it_is_cut(value: bytes, at: list[int]) -> None:
    body = model(value)
    whole = read([body])
    if b"\r\n--a-boundary" not in b"\r\n" + value and value:
        assert whole == (value, {"suite": "smoke@3", "name": "mine"})
    assert read(cut(body, at)) == whole
    assert read(bytes([byte]) for byte in body) == whole


@settings(max_examples=300)
@given(rest=pieces_of_a_body, at=places, good=st.booleans())
def test_any_body_has_one_result_however_it_is_cut(rest: bytes, at: list[int], good: bool) -> None:
    body = (part("suite", b"s") if good else b"--a-boundary\r\n") + rest
    whole = read([body])
    assert read(cut(body, at)) == whole
    assert read(bytes([byte]) for byte in body) == whole
