"""Checks the tensors that a model's file holds or declares."""

import math
from collections.abc import Sequence
from typing import Final

from onnx import TensorProto

from wrongturn_sandbox import rules
from wrongturn_sandbox.errors import ModelRefusedError

_ITEM_BYTES: Final[dict[int, int]] = {
    TensorProto.BOOL: 1,
    TensorProto.INT8: 1,
    TensorProto.UINT8: 1,
    TensorProto.INT16: 2,
    TensorProto.UINT16: 2,
    TensorProto.FLOAT16: 2,
    TensorProto.BFLOAT16: 2,
    TensorProto.INT32: 4,
    TensorProto.UINT32: 4,
    TensorProto.FLOAT: 4,
    TensorProto.INT64: 8,
    TensorProto.UINT64: 8,
    TensorProto.DOUBLE: 8,
}
"""Bytes of one element, for each type that is allowed."""


def check_tensor(tensor: TensorProto, where: str) -> int:
    """Check a tensor that a file holds, and return how many elements it has.

    Raises:
        ModelRefusedError: It lies outside the file, has a type that is not allowed, or its data do not fit its shape.
    """
    where = f"{where} {tensor.name[:64]!r}" if tensor.name else where
    if tensor.data_location != TensorProto.DEFAULT or len(tensor.external_data):
        raise ModelRefusedError(
            f"{where}: its data lie in another file; store them in the model itself "
            "(onnx.save with save_as_external_data=False)",
        )
    if tensor.HasField("segment"):
        raise ModelRefusedError(f"{where}: it is stored in segments, which is not allowed")
    check_type(tensor.data_type, where)
    elements = check_dimensions(tensor.dims, rules.PARAMETERS_MOST, where)
    if tensor.HasField("raw_data"):
        held, item = len(tensor.raw_data), _ITEM_BYTES[tensor.data_type]
        fits = held == elements * item and not _typed(tensor)
    else:
        fits = _typed(tensor) == elements
    if not fits:
        raise ModelRefusedError(f"{where}: its data do not have the length that its shape {list(tensor.dims)} asks for")
    return elements


def check_type(code: int, where: str) -> None:
    """Check that a type of elements is allowed.

    Raises:
        ModelRefusedError: It is not.
    """
    if code == TensorProto.STRING:
        raise ModelRefusedError(f"{where}: string tensors are not allowed")
    if code not in _ITEM_BYTES:
        raise ModelRefusedError(f"{where}: elements of type {code} are not allowed; use ordinary numbers")


def check_dimensions(lengths: Sequence[int], most: int, where: str, *, free: bool = False) -> int:
    """Check a shape, and return how many elements it has; Python's numbers do not overflow.

    Args:
        lengths: Length of each axis.
        most: Most elements.
        where: What has this shape.
        free: Whether a length of 0 means any; then it counts as 1.

    Raises:
        ModelRefusedError: It has too many axes, too many elements or a negative length.
    """
    if len(lengths) > rules.AXES_MOST:
        raise ModelRefusedError(f"{where}: {len(lengths)} axes; at most {rules.AXES_MOST} are allowed")
    if any(length < 0 for length in lengths):
        raise ModelRefusedError(f"{where}: a negative length in its shape")
    elements = math.prod(length or 1 for length in lengths) if free else math.prod(lengths)
    largest = max(lengths, default=0)
    if elements > most or largest > most:
        raise ModelRefusedError(f"{where}: a shape of {elements} elements; at most {most} are allowed")
    return elements


def _typed(tensor: TensorProto) -> int:
    """Return how many elements lie in the fields for one type each."""
    if len(tensor.string_data):
        raise ModelRefusedError("string tensors are not allowed")
    return (
        len(tensor.float_data)
        + len(tensor.int32_data)
        + len(tensor.int64_data)
        + len(tensor.double_data)
        + len(tensor.uint64_data)
    )
