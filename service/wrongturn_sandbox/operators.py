"""The operators that a model may use: those that compute numbers from numbers, always the same ones.

What is not listed is refused. Left out on purpose:

* control flow (``If``, ``Loop``, ``Scan``, ``SequenceMap``): it hides graphs in graphs and runs without end;
* random numbers (``RandomNormal``, ``Bernoulli`` and so on): the same observation must give the same action;
* strings, sequences, optional values, maps and pictures in file formats: a driving agent has no use for them, and
  their code is seldom tested;
* every domain but ONNX's own: custom operators, and onnxruntime's own operators.
"""

from typing import Final

_ARITHMETIC: Final = """
Abs Add Ceil Clip CumProd CumSum Div Einsum Exp Floor Gemm Log MatMul Max Mean Min Mod Mul Neg Pow Reciprocal Round Sign
Sqrt Sub Sum
"""
_TRIGONOMETRY: Final = "Acos Acosh Asin Asinh Atan Atanh Cos Cosh Erf Sin Sinh Tan Tanh"
_COMPARISON: Final = """
And BitShift BitwiseAnd BitwiseNot BitwiseOr BitwiseXor Equal Greater GreaterOrEqual IsInf IsNaN Less LessOrEqual Not Or
Where Xor
"""
_ACTIVATION: Final = """
Celu Elu Gelu HardSigmoid HardSwish Hardmax LeakyRelu LogSoftmax Mish PRelu Relu Selu Shrink Sigmoid Softmax Softplus
Softsign SwiGLU Swish ThresholdedRelu
"""
_LAYER: Final = """
Attention AveragePool BatchNormalization Conv ConvTranspose DeformConv Dropout GRU GlobalAveragePool GlobalLpPool
GlobalMaxPool GroupNormalization InstanceNormalization LRN LSTM LayerNormalization LpNormalization LpPool MaxPool
MeanVarianceNormalization RMSNormalization RNN RotaryEmbedding
"""
_REDUCTION: Final = """
ArgMax ArgMin ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum
ReduceSumSquare TopK
"""
_SHAPE: Final = """
AffineGrid Cast CastLike CenterCropPad Compress Concat Constant ConstantOfShape DepthToSpace Expand EyeLike Flatten
Gather GatherElements GatherND GridSample Identity NonZero OneHot Pad Range Reshape Resize ReverseSequence
ScatterElements ScatterND Shape Size Slice SpaceToDepth Split Squeeze Tile Transpose Trilu Unsqueeze Upsample
"""
_QUANTISATION: Final = """
ConvInteger DequantizeLinear DynamicQuantizeLinear MatMulInteger QLinearConv QLinearMatMul QuantizeLinear
"""

GROUPS: Final = {
    "arithmetic": frozenset(_ARITHMETIC.split()),
    "trigonometry": frozenset(_TRIGONOMETRY.split()),
    "comparison and logic": frozenset(_COMPARISON.split()),
    "activations": frozenset(_ACTIVATION.split()),
    "layers": frozenset(_LAYER.split()),
    "reductions": frozenset(_REDUCTION.split()),
    "shapes and indices": frozenset(_SHAPE.split()),
    "quantisation": frozenset(_QUANTISATION.split()),
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
