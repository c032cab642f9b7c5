"""What an ONNX file says of itself: inputs, outputs, opset and metadata, read without onnxruntime and ``onnx``.

The file is a ``ModelProto`` in protobuf's encoding (https://protobuf.dev/programming-guides/encoding/). The numbers of
the fields are those of https://github.com/onnx/onnx/blob/main/onnx/onnx.proto.
"""

from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Final

from wrongturn_protocol.model_contract import ContractError, ModelSignature, Shape, TensorSpec

# Fields of messages.
_GRAPH, _OPSET_IMPORT, _METADATA = 7, 8, 14  # of ModelProto
_INITIALIZER, _INPUT, _OUTPUT, _SPARSE_INITIALIZER = 5, 11, 12, 15  # of GraphProto
_TENSOR_NAME: Final = 8  # of TensorProto
_TENSOR_TYPE: Final = 1  # of TypeProto
# Of the other messages, 1 is the name, key, domain, type of elements, list of sizes or size, and 2 what belongs to it.
_FIRST, _SECOND = 1, 2

_DTYPES: Final = (
    "undefined",
    "float32",
    "uint8",
    "int8",
    "uint16",
    "int16",
    "int32",
    "int64",
    "string",
    "bool",
    "float16",
    "float64",
    "uint32",
    "uint64",
    "complex64",
    "complex128",
    "bfloat16",
)
"""Names of the types of elements, in the order of their numbers."""
_DEFAULT_DOMAIN: Final = ("", "ai.onnx")
_LONGEST: Final = 4096
"""Most bytes of a text that are read."""
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5

Span = tuple[int, int]
"""Where the bytes of a message begin and end in the file."""


def signature_of(file: Path) -> ModelSignature:
    """Return what a model takes and gives, by its file alone.

    Sizes that the file does not declare are free. onnxruntime may find out more.

    Raises:
        ContractError: The file is no ONNX model, or is cut off.
        OSError: The file cannot be read.
    """
    try:
        with file.open("rb") as opened, mmap(opened.fileno(), 0, access=ACCESS_READ) as data:
            return _model(data)
    except (ValueError, IndexError) as error:
        if isinstance(error, ContractError):
            raise
        raise ContractError("the file is no ONNX model, or is cut off; export the model again") from error


def opset_of(file: Path) -> int:
    """Return the version of ONNX's default domain that a model imports; 0 if it imports none, or is no ONNX model."""
    try:
        return signature_of(file).opset
    except (OSError, ContractError):
        return 0


def _model(data: mmap) -> ModelSignature:
    inputs: list[TensorSpec] = []
    outputs: list[TensorSpec] = []
    constants: set[str] = set()
    opsets = [0]
    metadata = {}
    for field, value in _fields(data, (0, len(data))):
        if field == _GRAPH:
            for part, inside in _fields(data, _span(value)):
                if part == _INITIALIZER:
                    constants.add(_text_in(data, inside, _TENSOR_NAME))
                elif part == _SPARSE_INITIALIZER:
                    constants.update(_text_in(data, tensor, _TENSOR_NAME) for tensor in _all(data, inside, _FIRST))
                elif part == _INPUT:
                    inputs.append(_tensor(data, inside))
                elif part == _OUTPUT:
                    outputs.append(_tensor(data, inside))
        elif field == _OPSET_IMPORT and _text_in(data, value, _FIRST) in _DEFAULT_DOMAIN:
            opsets += [version for version in _all(data, value, _SECOND) if isinstance(version, int)]
        elif field == _METADATA:
            metadata[_text_in(data, value, _FIRST)] = _text_in(data, value, _SECOND)
    if not outputs:
        raise ContractError("the file holds no graph; export the model to ONNX again")
    # Files of old versions list the weights among the inputs.
    taken = tuple(put for put in inputs if put.name not in constants)
    return ModelSignature(taken, tuple(outputs), max(opsets), metadata)


def _tensor(data: mmap, value: int | Span) -> TensorSpec:
    """Return an input or output, which is a ``ValueInfoProto``."""
    dtype = "no tensor"
    shape: Shape = ()
    for kind in _all(data, value, _SECOND):
        for tensor in _all(data, kind, _TENSOR_TYPE):
            (number,) = [each for each in _all(data, tensor, _FIRST) if isinstance(each, int)][-1:] or [0]
            dtype = _DTYPES[number] if number < len(_DTYPES) else f"type {number}"
            shape = tuple(_size(data, size) for sizes in _all(data, tensor, _SECOND) for size in _all(data, sizes, 1))
    return TensorSpec(_text_in(data, value, _FIRST), dtype, shape)


def _size(data: mmap, value: int | Span) -> int | str | None:
    """Return the size of an axis: a number, the name of a free one, or None."""
    for field, size in _fields(data, _span(value)):
        if field == _FIRST and isinstance(size, int):
            return size if size < 1 << 63 else None  # negative numbers are free axes too
        if field == _SECOND:
            return _text(data, size) or None
    return None


def _all(data: mmap, value: int | Span, wanted: int) -> Iterator[int | Span]:
    """Yield the values of one field of a message."""
    return (inside for field, inside in _fields(data, _span(value)) if field == wanted)


def _text_in(data: mmap, value: int | Span, wanted: int) -> str:
    """Return a field of a message as text; empty if there is none. The last one counts, as in protobuf."""
    found = ""
    for inside in _all(data, value, wanted):
        found = _text(data, inside)
    return found


def _text(data: mmap, value: int | Span) -> str:
    begin, end = _span(value)
    return data[begin : min(end, begin + _LONGEST)].decode(errors="replace")


def _span(value: int | Span) -> Span:
    """Return a value as the place of a message. Raises ValueError."""
    if isinstance(value, int):
        raise ValueError("a number stands where a message should")
    return value


def _fields(data: mmap, span: Span) -> Iterator[tuple[int, int | Span]]:
    """Yield number and value of each field of a message; of bytes, their place. Raises ValueError or IndexError."""
    at, end = span
    while at < end:
        key, at = _varint(data, at)
        kind = key & 7
        if kind == _VARINT:
            value, at = _varint(data, at)
            yield key >> 3, value
        elif kind == _BYTES:
            size, at = _varint(data, at)
            if at + size > end:
                raise ValueError("it is cut off")
            yield key >> 3, (at, at + size)
            at += size
        elif kind in {_FIXED64, _FIXED32}:
            at += 8 if kind == _FIXED64 else 4
        else:
            raise ValueError("it is not in protobuf's encoding")


def _varint(data: mmap, at: int) -> tuple[int, int]:
    """Return the number that begins at a place, and the place after it."""
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("it is not in protobuf's encoding")
