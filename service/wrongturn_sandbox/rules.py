"""Rules for a model's file, checked before onnxruntime sees it: its limits, and the operators that it may use.

The operators are those that compute numbers from numbers, always the same ones. What is not listed is refused. Left out
on purpose:

* control flow (``If``, ``Loop``, ``Scan``, ``SequenceMap``): it hides graphs in graphs and runs without end;
* random numbers (``RandomNormal``, ``Bernoulli`` and so on): the same observation must give the same action;
* strings, sequences, optional values, maps and pictures in file formats: a driving agent has no use for them, and
  their code is seldom tested;
* every domain but ONNX's own: custom operators, and onnxruntime's own operators.
"""

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
INPUT_MOST: Final = 1 << 22
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

GROUPS: Final = {
    kind: frozenset(operators.split())
    for kind, operators in {
        "arithmetic": """
            Abs Add Ceil Clip CumProd CumSum Div Einsum Exp Floor Gemm Log MatMul Max Mean Min Mod Mul Neg Pow
            Reciprocal Round Sign Sqrt Sub Sum
        """,
        "trigonometry": "Acos Acosh Asin Asinh Atan Atanh Cos Cosh Erf Sin Sinh Tan Tanh",
        "comparison and logic": """
            And BitShift BitwiseAnd BitwiseNot BitwiseOr BitwiseXor Equal Greater GreaterOrEqual IsInf IsNaN Less
            LessOrEqual Not Or Where Xor
        """,
        "activations": """
            Celu Elu Gelu HardSigmoid HardSwish Hardmax LeakyRelu LogSoftmax Mish PRelu Relu Selu Shrink Sigmoid Softmax
            Softplus Softsign SwiGLU Swish ThresholdedRelu
        """,
        "layers": """
            Attention AveragePool BatchNormalization Conv ConvTranspose DeformConv Dropout GRU GlobalAveragePool
            GlobalLpPool GlobalMaxPool GroupNormalization InstanceNormalization LRN LSTM LayerNormalization
            LpNormalization LpPool MaxPool MeanVarianceNormalization RMSNormalization RNN RotaryEmbedding
        """,
        "reductions": """
            ArgMax ArgMin ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd
            ReduceSum ReduceSumSquare TopK
        """,
        "shapes and indices": """
            AffineGrid Cast CastLike CenterCropPad Compress Concat Constant ConstantOfShape DepthToSpace Expand EyeLike
            Flatten Gather GatherElements GatherND GridSample Identity NonZero OneHot Pad Range Reshape Resize
            ReverseSequence ScatterElements ScatterND Shape Size Slice SpaceToDepth Split Squeeze Tile Transpose Trilu
            Unsqueeze Upsample
        """,
        "quantisation": """
            ConvInteger DequantizeLinear DynamicQuantizeLinear MatMulInteger QLinearConv QLinearMatMul QuantizeLinear
        """,
    }.items()
}
"""The allowed operators by kind. All are of ONNX's default domain."""
OPERATORS: Final = frozenset[str]().union(*GROUPS.values())
"""The allowed operators."""
DOMAINS: Final = frozenset({"", "ai.onnx"})
"""The allowed domains: both are names of ONNX's default one."""
CONTROL_FLOW: Final = frozenset({"If", "Loop", "Scan", "SequenceMap"})
"""Operators that are refused because they hold graphs."""
RANDOM: Final = frozenset(
    {"Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike"}
)
"""Operators that are refused because they draw random numbers."""
