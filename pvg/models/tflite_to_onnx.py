"""Convert the TFLite networks this library uses to ONNX: a reader of just their operators.

TFLite keeps images as (batch, height, width, channels), ONNX as (batch, channels, height, width). Every rank-4
tensor inside the converted graph has channels first; the graph's own inputs and outputs keep TFLite's order, so
callers see the shapes the model card gives. Half-precision weights become float32.
"""

from __future__ import annotations

import platform
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import tflite
from onnx import TensorProto, helper, numpy_helper

from pvg.errors import ModelError

Array = npt.NDArray[Any]

OPSET = 17
IR_VERSION = 8
_TO_CHANNELS_FIRST = (0, 3, 1, 2)
_TO_CHANNELS_LAST = (0, 2, 3, 1)
_DTYPES: dict[int, type[np.generic]] = {
    tflite.TensorType.FLOAT32: np.float32,
    tflite.TensorType.FLOAT16: np.float16,
    tflite.TensorType.INT32: np.int32,
}
# where onnxruntime's processor library has kernels for channels in blocks; elsewhere 1×1 depthwise convolutions crawl
_BLOCKED_CHANNELS = platform.machine().lower() in ("x86_64", "amd64")
_OPERATOR_NAMES = {value: name for name, value in vars(tflite.BuiltinOperator).items() if not name.startswith("_")}


def convert(data: bytes, name: str, outputs: Sequence[str] = ()) -> bytes:
    """Convert one TFLite flatbuffer to a serialised ONNX model computing the same function.

    outputs: the names of the tensors that are wanted, its own outputs where empty. What lies behind them is left out.

    Raises ModelError when the file is not TFLite, uses an operator this reader does not know or has no such output.
    """
    if data[4:8] != b"TFL3":
        raise ModelError(f"{name} is not a TFLite file; remove the cache folder and run `make setup`")
    model = tflite.Model.GetRootAsModel(data, 0)
    proto = _Graph(model, name).build(outputs)
    onnx.checker.check_model(proto)
    return bytes(proto.SerializeToString(deterministic=True))


class _Graph:
    """One TFLite graph being rewritten; tensors are named t0, t1, … after their TFLite index."""

    def __init__(self, model: Any, name: str) -> None:
        self._model = model
        self._name = name
        self._graph = model.Subgraphs(0)
        self._nodes: list[onnx.NodeProto] = []
        self._initializers: list[onnx.TensorProto] = []
        # weights by tensor index, in TFLite's order; DEQUANTIZE outputs join them
        self._constants: dict[int, Array] = {}
        for index in range(self._graph.TensorsLength()):
            constant = self._stored_constant(index)
            if constant is not None:
                self._constants[index] = constant

    def build(self, wanted: Sequence[str]) -> onnx.ModelProto:
        graph = self._graph
        ends = self._ends(wanted)
        inputs = []
        for index in graph.InputsAsNumpy():
            inputs.append(helper.make_tensor_value_info(f"in{index}", TensorProto.FLOAT, self._shape(int(index))))
            self._transpose(f"in{index}", self._tensor(int(index)), _TO_CHANNELS_FIRST)
        left = set(ends)
        for number in range(graph.OperatorsLength()):
            if not left:
                break
            operator = graph.Operators(number)
            left.difference_update(int(index) for index in operator.OutputsAsNumpy())
            operator_name = self._operator_name(operator)
            handler = _HANDLERS.get(operator_name)
            if handler is None:
                raise ModelError(f"{self._name} uses the operator {operator_name}, which is not supported")
            handler(self, operator)
        outputs = []
        for index in ends:
            shape = self._shape(index)
            name = graph.Tensors(index).Name().decode()
            outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
            if len(shape) == 4:
                self._transpose(self._tensor(index), name, _TO_CHANNELS_LAST)
            else:
                self._emit("Identity", [self._tensor(index)], name)
        proto = helper.make_model(
            helper.make_graph(self._nodes, self._name, inputs, outputs, self._initializers),
            opset_imports=[helper.make_opsetid("", OPSET)],
            producer_name="pvg",
        )
        proto.ir_version = IR_VERSION
        return proto

    # --- reading ---

    def _ends(self, wanted: Sequence[str]) -> list[int]:
        """The tensors that the converted graph gives: those named, or the graph's own outputs."""
        if not wanted:
            return [int(index) for index in self._graph.OutputsAsNumpy()]
        names = {self._graph.Tensors(i).Name().decode(): i for i in range(self._graph.TensorsLength())}
        missing = [name for name in wanted if name not in names]
        if missing:
            raise ModelError(f"{self._name} has no tensor {missing[0]}")
        return [names[name] for name in wanted]

    def _operator_name(self, operator: Any) -> str:
        code = self._model.OperatorCodes(operator.OpcodeIndex())
        # codes up to 126 are stored in the old one-byte field by old writers
        builtin = max(code.BuiltinCode(), code.DeprecatedBuiltinCode())
        if builtin == tflite.BuiltinOperator.CUSTOM:
            return str(code.CustomCode().decode())
        return str(_OPERATOR_NAMES.get(builtin, builtin))

    def _shape(self, index: int) -> list[int]:
        tensor = self._graph.Tensors(index)
        return [int(size) for size in tensor.ShapeAsNumpy()] if tensor.ShapeLength() else []

    def _stored_constant(self, index: int) -> Array | None:
        tensor = self._graph.Tensors(index)
        buffer = self._model.Buffers(tensor.Buffer())
        if not buffer.DataLength():
            return None
        dtype = _DTYPES.get(tensor.Type())
        if dtype is None:
            raise ModelError(f"{self._name} holds weights of TFLite type {tensor.Type()}, which is not supported")
        return np.frombuffer(buffer.DataAsNumpy().tobytes(), dtype).reshape(self._shape(index))

    def constant(self, index: int) -> Array:
        if index not in self._constants:
            raise ModelError(f"{self._name}: tensor {index} should be a constant and is computed")
        return self._constants[index]

    def inputs(self, operator: Any) -> list[int]:
        return [int(index) for index in operator.InputsAsNumpy()]

    def output(self, operator: Any) -> int:
        return int(operator.Outputs(0))

    def options(self, operator: Any, kind: type[Any]) -> Any:
        options = kind()
        table = operator.BuiltinOptions()
        options.Init(table.Bytes, table.Pos)
        return options

    # --- writing ---

    def _tensor(self, index: int) -> str:
        return f"t{index}"

    def initializer(self, values: Array) -> str:
        name = f"c{len(self._initializers)}"
        self._initializers.append(numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def _emit(self, kind: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        self._nodes.append(helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def _transpose(self, source: str, target: str, order: Sequence[int]) -> str:
        return self._emit("Transpose", [source], target, perm=list(order))

    def operand(self, index: int) -> str:
        """Name of an input tensor, channels first; a constant becomes an initializer of matching rank."""
        if index not in self._constants:
            return self._tensor(index)
        values = self._constants[index].astype(np.float32)
        return self.initializer(values.transpose(_TO_CHANNELS_FIRST) if values.ndim == 4 else values)

    def emit(self, kind: str, inputs: Sequence[str], output: int, activation: int = 0, **attributes: Any) -> None:
        """Append a node writing tensor `output`, with the activation TFLite fused into it."""
        name = self._tensor(output)
        if activation == tflite.ActivationFunctionType.NONE:
            self._emit(kind, inputs, name, **attributes)
            return
        raw = self._emit(kind, inputs, f"{name}_raw", **attributes)
        if activation == tflite.ActivationFunctionType.RELU:
            self._emit("Relu", [raw], name)
        elif activation == tflite.ActivationFunctionType.RELU6:
            low, high = self.initializer(np.float32(0)), self.initializer(np.float32(6))  # type: ignore[arg-type]
            self._emit("Clip", [raw, low, high], name)
        else:
            raise ModelError(f"{self._name} uses the fused activation {activation}, which is not supported")

    def same_pads(
        self, source: int, output: int, kernel: Sequence[int], stride: Sequence[int], padding: int
    ) -> list[int]:
        """ONNX pads [top, left, bottom, right]; TFLite puts the odd pixel of SAME at the bottom right."""
        if padding == tflite.Padding.VALID:
            return [0, 0, 0, 0]
        before, after = [], []
        for axis in (0, 1):
            size = self._shape(source)[1 + axis]
            steps = self._shape(output)[1 + axis]
            total = max((steps - 1) * stride[axis] + kernel[axis] - size, 0)
            before.append(total // 2)
            after.append(total - total // 2)
        return before + after

    # --- operators ---

    def dequantize(self, operator: Any) -> None:
        source = self.inputs(operator)[0]
        if self.constant(source).dtype != np.float16:
            raise ModelError(f"{self._name}: only half-precision weights can be dequantised")
        self._constants[self.output(operator)] = self.constant(source).astype(np.float32)

    def conv(self, operator: Any, depthwise: bool) -> None:
        kind = tflite.DepthwiseConv2DOptions if depthwise else tflite.Conv2DOptions
        options = self.options(operator, kind)
        source, weight_index, bias_index = self.inputs(operator)
        weights = self.constant(weight_index).astype(np.float32)
        # (1, h, w, out) for depthwise, (out, h, w, in) otherwise; ONNX wants (out, in / group, h, w)
        weights = weights.transpose((3, 0, 1, 2) if depthwise else _TO_CHANNELS_FIRST)
        kernel = weights.shape[2:]
        stride = [options.StrideH(), options.StrideW()]
        if (options.DilationHFactor(), options.DilationWFactor()) != (1, 1):
            raise ModelError(f"{self._name} uses a dilated convolution, which is not supported")
        self.emit(
            "Conv",
            [self.operand(source), self.initializer(weights), self.operand(bias_index)],
            self.output(operator),
            options.FusedActivationFunction(),
            kernel_shape=list(kernel),
            strides=stride,
            pads=self.same_pads(source, self.output(operator), kernel, stride, options.Padding()),
            group=self._shape(source)[3] if depthwise else 1,
        )

    def transposed_conv(self, operator: Any) -> None:
        # MediaPipe's custom operator; its options are TfLiteTransposeConvParams: padding, stride w, stride h
        _padding, stride_w, stride_h = struct.unpack_from("<3i", operator.CustomOptionsAsNumpy().tobytes())
        source, weight_index, bias_index = self.inputs(operator)
        weights = self.constant(weight_index).astype(np.float32).transpose(3, 0, 1, 2)  # (in, out, h, w)
        kernel, stride = weights.shape[2:], (stride_h, stride_w)
        size = self._shape(source)[1:3]
        target = self._shape(self.output(operator))[1:3]
        if any((n - 1) * s + k != t for n, s, k, t in zip(size, stride, kernel, target, strict=True)):
            raise ModelError(f"{self._name} uses a padded transposed convolution, which is not supported")
        self.emit(
            "ConvTranspose",
            [self.operand(source), self.initializer(weights), self.operand(bias_index)],
            self.output(operator),
            kernel_shape=list(kernel),
            strides=list(stride),
        )

    def pool(self, operator: Any, kind: str) -> None:
        options = self.options(operator, tflite.Pool2DOptions)
        source = self.inputs(operator)[0]
        kernel = [options.FilterHeight(), options.FilterWidth()]
        stride = [options.StrideH(), options.StrideW()]
        self.emit(
            kind,
            [self.operand(source)],
            self.output(operator),
            options.FusedActivationFunction(),
            kernel_shape=kernel,
            strides=stride,
            pads=self.same_pads(source, self.output(operator), kernel, stride, options.Padding()),
        )

    def binary(self, operator: Any, kind: str) -> None:
        options = self.options(operator, tflite.AddOptions if kind == "Add" else tflite.MulOptions)
        self.emit(
            kind,
            [self.operand(index) for index in self.inputs(operator)],
            self.output(operator),
            options.FusedActivationFunction(),
        )

    def unary(self, operator: Any, kind: str) -> None:
        self.emit(kind, [self.operand(self.inputs(operator)[0])], self.output(operator))

    def prelu(self, operator: Any) -> None:
        # onnxruntime's own PRelu is not vectorised over channels
        source, slope_index = self.inputs(operator)
        slope = self.constant(slope_index).astype(np.float32).reshape(-1)
        x, name = self.operand(source), self._tensor(self.output(operator))
        if _BLOCKED_CHANNELS:
            self._prelu_by_convolutions(x, slope, name)
            return
        positive = self._emit("Relu", [x], f"{name}_pos")
        negative = self._emit("Min", [x, self.initializer(np.zeros((), np.float32))], f"{name}_neg")
        scaled = self._emit("Mul", [negative, self.initializer(slope.reshape(-1, 1, 1))], f"{name}_scaled")
        self._emit("Add", [positive, scaled], name)

    def _prelu_by_convolutions(self, x: str, slope: Array, name: str) -> None:
        """slope · x + (1 − slope) · Relu(x), scaled by depthwise 1×1 convolutions.

        onnxruntime keeps channels in blocks from convolution to convolution and fuses the sum, and where no slope
        is above 1 also the Relu, into them; Min and Mul would have every tensor reordered twice.
        """
        if (slope <= 1).all():  # (1 − slope) · Relu(x) = Relu((1 − slope) · x)
            rise = self._emit("Relu", [self._scaled(x, 1 - slope, f"{name}_steep")], f"{name}_rise")
        else:
            rise = self._scaled(self._emit("Relu", [x], f"{name}_pos"), 1 - slope, f"{name}_rise")
        self._emit("Add", [self._scaled(x, slope, f"{name}_line"), rise], name)

    def _scaled(self, x: str, factors: Array, output: str) -> str:
        weights = self.initializer(factors.reshape(-1, 1, 1, 1))
        return self._emit("Conv", [x, weights], output, group=len(factors), kernel_shape=[1, 1])

    def pad(self, operator: Any) -> None:
        source, pads_index = self.inputs(operator)
        pads = self.constant(pads_index)[list(_TO_CHANNELS_FIRST)]
        amounts = self.initializer(pads.T.reshape(-1).astype(np.int64))
        self.emit("Pad", [self.operand(source), amounts], self.output(operator))

    def reshape(self, operator: Any) -> None:
        source, output = self.inputs(operator)[0], self.output(operator)
        name = self.operand(source)
        if len(self._shape(source)) == 4:
            name = self._transpose(name, f"t{output}_last", _TO_CHANNELS_LAST)
        shape = self._shape(output)
        if len(shape) == 4:
            raise ModelError(f"{self._name} reshapes to rank 4, which is not supported")
        self.emit("Reshape", [name, self.initializer(np.array(shape, np.int64))], output)

    def concatenation(self, operator: Any) -> None:
        options = self.options(operator, tflite.ConcatenationOptions)
        output = self.output(operator)
        rank = len(self._shape(output))
        axis = options.Axis() % rank
        if rank == 4:
            axis = _TO_CHANNELS_FIRST.index(axis)
        self.emit(
            "Concat",
            [self.operand(index) for index in self.inputs(operator)],
            output,
            options.FusedActivationFunction(),
            axis=axis,
        )

    def resize_bilinear(self, operator: Any) -> None:
        options = self.options(operator, tflite.ResizeBilinearOptions)
        source, output = self.inputs(operator)[0], self.output(operator)
        mode = "asymmetric"
        if options.AlignCorners():
            mode = "align_corners"
        elif options.HalfPixelCenters():
            mode = "half_pixel"
        shape = [self._shape(output)[axis] for axis in _TO_CHANNELS_FIRST]
        self.emit(
            "Resize",
            [self.operand(source), "", "", self.initializer(np.array(shape, np.int64))],
            output,
            mode="linear",
            coordinate_transformation_mode=mode,
        )


_HANDLERS: dict[str, Callable[[_Graph, Any], None]] = {
    "DEQUANTIZE": _Graph.dequantize,
    "CONV_2D": lambda graph, operator: graph.conv(operator, depthwise=False),
    "DEPTHWISE_CONV_2D": lambda graph, operator: graph.conv(operator, depthwise=True),
    "Convolution2DTransposeBias": _Graph.transposed_conv,
    "MAX_POOL_2D": lambda graph, operator: graph.pool(operator, "MaxPool"),
    "AVERAGE_POOL_2D": lambda graph, operator: graph.pool(operator, "AveragePool"),
    "ADD": lambda graph, operator: graph.binary(operator, "Add"),
    "MUL": lambda graph, operator: graph.binary(operator, "Mul"),
    "RELU": lambda graph, operator: graph.unary(operator, "Relu"),
    "LOGISTIC": lambda graph, operator: graph.unary(operator, "Sigmoid"),
    "HARD_SWISH": lambda graph, operator: graph.unary(operator, "HardSwish"),
    "PRELU": _Graph.prelu,
    "PAD": _Graph.pad,
    "RESHAPE": _Graph.reshape,
    "CONCATENATION": _Graph.concatenation,
    "RESIZE_BILINEAR": _Graph.resize_bilinear,
}
