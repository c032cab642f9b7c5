"""What an ONNX file says of itself: inputs, outputs, opset and metadata, read without onnxruntime and ``onnx``.

The file is a ``ModelProto`` in protobuf's encoding (https://protobuf.dev/programming-guides/encoding/). The numbers of
the fields are those of https://github.com/onnx/onnx/blob/main/onnx/onnx.proto.
"""

from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Final

from wrongturn_protocol.model_contract import ContractError, ModelSignature, TensorSpec

# Fields of messages.
_GRAPH, _OPSET_IMPORT, _METADATA = 7, 8, 14  # of ModelProto
_INITIALIZER, _INPUT, _OUTPUT, _SPARSE_INITIALIZER = 5, 11, 12, 15  # of GraphProto
_TENSOR_NAME, _EXTERNAL_DATA = 8, 13  # of TensorProto
_TENSOR_TYPE: Final = 1  # of TypeProto
# Of the other messages, 1 is the name, key, domain, type of elements, list of sizes or size, and 2 what belongs to it.
_FIRST, _SECOND = 1, 2

_DTYPES: Final = (
    *("undefined", "float32", "uint8", "int8", "uint16", "int16", "int32", "int64", "string", "bool", "float16"),
    *("float64", "uint32", "uint64", "complex64", "complex128", "bfloat16"),
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
            return _Reader(data).signature()
    except (ValueError, IndexError) as error:
        if isinstance(error, ContractError):
            raise
        raise ContractError("the file is no ONNX model, or is cut off; export the model again") from error


def check_whole(file: Path) -> None:
    """Raise ContractError if weights of a model that :func:`signature_of` has read lie in another file."""
    with file.open("rb") as opened, mmap(opened.fileno(), 0, access=ACCESS_READ) as data:
        if _Reader(data).needs_another_file():
            raise ContractError(
                "weights lie in another file; store them in the model itself (onnx.save with save_as_external_data="
                "False, torch.onnx.export with external_data=False)"
            )


def opset_of(file: Path) -> int:
    """Return the version of ONNX's default domain that a model imports; 0 if it imports none, or is no ONNX model."""
    try:
        return signature_of(file).opset
    except (OSError, ContractError):
        return 0


class _Reader:
    """Reads fields of messages. What is no protobuf raises ValueError or IndexError."""

    def __init__(self, data: mmap) -> None:
        self._data = data

    def signature(self) -> ModelSignature:
        whole = (0, len(self._data))
        outputs = tuple(map(self._tensor, self._values(whole, _GRAPH, _OUTPUT)))
        if not outputs:
            raise ContractError("the file holds no graph; export the model to ONNX again")
        # Files of old versions list the weights among the inputs.
        weights = {self._text(name) for name in self._values(whole, _GRAPH, _INITIALIZER, _TENSOR_NAME)}
        weights |= {self._text(name) for name in self._values(whole, _GRAPH, _SPARSE_INITIALIZER, _FIRST, _TENSOR_NAME)}
        inputs = map(self._tensor, self._values(whole, _GRAPH, _INPUT))
        opsets = [
            self._number(imported, _SECOND)
            for imported in self._values(whole, _OPSET_IMPORT)
            if self._text_in(imported, _FIRST) in _DEFAULT_DOMAIN
        ]
        entries = self._values(whole, _METADATA)
        metadata = {self._text_in(entry, _FIRST): self._text_in(entry, _SECOND) for entry in entries}
        taken = tuple(put for put in inputs if put.name not in weights)
        return ModelSignature(taken, outputs, max(opsets, default=0), metadata)

    def needs_another_file(self) -> bool:
        return any(self._values((0, len(self._data)), _GRAPH, _INITIALIZER, _EXTERNAL_DATA))

    def _tensor(self, value: int | Span) -> TensorSpec:
        """Return an input or output, which is a ``ValueInfoProto``."""
        name, dtype = self._text_in(value, _FIRST), "no tensor"
        sizes = tuple(map(self._size, self._values(value, _SECOND, _TENSOR_TYPE, _SECOND, _FIRST)))
        for tensor in self._values(value, _SECOND, _TENSOR_TYPE):
            number = self._number(tensor, _FIRST)
            dtype = _DTYPES[number] if number < len(_DTYPES) else f"type {number}"
        return TensorSpec(name, dtype, sizes)

    def _size(self, value: int | Span) -> int | str | None:
        """Return the size of an axis: a number, the name of a free one, or None."""
        for field, size in self._fields(value):
            if field == _FIRST and isinstance(size, int):
                return size if size < 1 << 63 else None  # negative numbers are free axes too
            if field == _SECOND:
                return self._text(size) or None
        return None

    def _values(self, value: int | Span, *path: int) -> Iterator[int | Span]:
        """Yield the values of a field of a message, or of a field of messages in it."""
        for field, inside in self._fields(value):
            if field == path[0]:
                yield from self._values(inside, *path[1:]) if path[1:] else (inside,)

    def _number(self, value: int | Span, wanted: int) -> int:
        """Return a field of a message as a number; 0 if there is none. The last one counts, as in protobuf."""
        return ([0] + [number for number in self._values(value, wanted) if isinstance(number, int)])[-1]

    def _text_in(self, value: int | Span, wanted: int) -> str:
        """Return a field of a message as text; empty if there is none."""
        return (["", *map(self._text, self._values(value, wanted))])[-1]

    def _text(self, value: int | Span) -> str:
        begin, end = _span(value)
        return self._data[begin : min(end, begin + _LONGEST)].decode(errors="replace")

    def _fields(self, value: int | Span) -> Iterator[tuple[int, int | Span]]:
        """Yield number and value of each field of a message; of bytes, their place."""
        at, end = _span(value)
        while at < end:
            key, at = self._varint(at)
            kind = key & 7
            if kind == _VARINT:
                number, at = self._varint(at)
                yield key >> 3, number
            elif kind == _BYTES:
                size, at = self._varint(at)
                if at + size > end:
                    raise ValueError("it is cut off")
                yield key >> 3, (at, at + size)
                at += size
            elif kind in {_FIXED64, _FIXED32}:
                at += 8 if kind == _FIXED64 else 4
            else:
                raise ValueError("it is not in protobuf's encoding")

    def _varint(self, at: int) -> tuple[int, int]:
        """Return the number that begins at a place, and the place after it."""
        value = shift = 0
        while shift < 70:
            byte = self._data[at]
            value |= (byte & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if byte < 0x80:
                return value, at
        raise ValueError("it is not in protobuf's encoding")


def _span(value: int | Span) -> Span:
    """Return a value as the place of a message."""
    if isinstance(value, int):
        raise ValueError("a number stands where a message should")
    return value
