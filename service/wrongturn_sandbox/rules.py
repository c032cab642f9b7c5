"""Limits on a model's file, checked before onnxruntime sees it."""

from typing import Final

OPSETS: Final = range(7, 27)
"""Versions of ONNX's default operators."""
IR_VERSIONS: Final = range(3, 14)
"""Versions of the file format."""
NODES_MOST: Final = 10_000
"""Most nodes."""
CONSTANTS_MOST: Final = 20_000
"""Most initialisers and tensors in attributes."""
PARAMETERS_MOST: Final = 250_000_000
"""Most numbers in all constants."""
VALUES_MOST: Final = 40_000
"""Most values whose type the file declares."""
PORTS_MOST: Final = 256
"""Most inputs, and most outputs, of a node."""
ATTRIBUTES_MOST: Final = 32
"""Most attributes of a node."""
ATTRIBUTE_LENGTH_MOST: Final = 4096
"""Most numbers or bytes in an attribute that is no tensor."""
AXES_MOST: Final = 16
"""Most axes of a tensor in the graph."""
DECLARED_MOST: Final = 1 << 31
"""Most elements of a tensor, by the shape that the file declares."""
INPUT_MOST: Final = 1 << 20
"""Most elements of an input, with a batch of 1."""
OUTPUT_MOST: Final = 1 << 18
"""Most elements of an output, with a batch of 1."""
TENSORS_MOST: Final = 64
"""Most inputs, and most outputs, of the model."""
NAME_MOST: Final = 512
"""Longest name, characters."""
METADATA_MOST: Final = 128
"""Most entries of the metadata."""
METADATA_LENGTH_MOST: Final = 1 << 18
"""Most characters of the metadata in all."""
OUTPUT_BYTES_MOST: Final = 4 << 20
"""Most bytes of all outputs of a step."""
