"""Forms that hand a model in, byte by byte as a client sends them."""

BOUNDARY = "a-boundary"
TYPE = f"multipart/form-data; boundary={BOUNDARY}"


def part(name: str, value: bytes, head: str = "", disposition: str | None = None) -> bytes:
    """One part of a form."""
    said = f'form-data; name="{name}"' if disposition is None else disposition
    return f"--{BOUNDARY}\r\nContent-Disposition: {said}\r\n{head}\r\n".encode() + value + b"\r\n"


def form(*parts: bytes) -> bytes:
    """A form of these parts."""
    return b"".join(parts) + f"--{BOUNDARY}--\r\n".encode()


def model(value: bytes = b"a model", name: str = "mine", suite: str = "smoke@3") -> bytes:
    """A form that hands a model in."""
    return form(part("suite", suite.encode()), part("name", name.encode()), part("model", value))
