"""Writing a network as an ONNX graph: any input size, weights of 16 bits, no torch."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stillroom.geometry.arrays import F32

OPSET = 17
IR_VERSION = 8
LARGEST_FLOAT16 = 65504.0


class Graph:
    """An ONNX graph under construction. Values are known by name; each method adds nodes that make one."""

    def __init__(self, half: bool) -> None:
        """Begin with nothing.

        Args:
            half: Whether weights are stored as 16-bit numbers, which are turned into 32 bits when it is loaded.
        """
        import onnx

        self._helper, self._numpy, self._types = onnx.helper, onnx.numpy_helper, onnx.TensorProto
        self._half = half
        self._count = 0
        self._known: set[str] = set()
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def add(self, operator: str, inputs: Sequence[str], makes: str = "", **attributes: Any) -> str:
        """Add a node; return the name of what it makes."""
        name = makes or self._name(operator.lower())
        self.nodes.append(self._helper.make_node(operator, list(inputs), [name], name=name, **attributes))
        return name

    def weight(self, name: str, values: F32) -> str:
        """Add weights, once; return the name under which nodes read them."""
        if name in self._known:
            return name
        self._known.add(name)
        if not self._half:
            self.weights.append(self._numpy.from_array(np.asarray(values, dtype=np.float32), name))
            return name
        fit = np.clip(values, -LARGEST_FLOAT16, LARGEST_FLOAT16).astype(np.float16)
        self.weights.append(self._numpy.from_array(fit, f"{name}.half"))
        return self.add("Cast", [f"{name}.half"], name, to=self._types.FLOAT)

    def numbers(self, values: Any, kind: Any) -> str:
        """Add constants; return their name."""
        name = self._name("numbers")
        self.weights.append(self._numpy.from_array(np.asarray(values, dtype=kind), name))
        return name

    def side(self, value: str, axis: int) -> str:
        """Return the name of an int64 (1,): how large a value is along an axis."""
        shape = self.add("Shape", [value])
        return self.add("Gather", [shape, self.numbers([axis], np.int64)], axis=0)

    def size(self, value: str) -> str:
        """Return the name of an int64 (2,): rows and columns of a value."""
        shape = self.add("Shape", [value])
        return self.add("Slice", [shape, self.numbers([2], np.int64), self.numbers([4], np.int64)])

    def resized(self, value: str, rows_columns: str, corners: bool, to: str = "") -> str:
        """Add bilinear resizing; return the name of what it makes."""
        first = self.add(
            "Slice", [self.add("Shape", [value]), self.numbers([0], np.int64), self.numbers([2], np.int64)]
        )
        sizes = self.add("Concat", [first, rows_columns], axis=0)
        mode = "align_corners" if corners else "half_pixel"
        return self.add(
            "Resize", [value, "", "", sizes], to, mode="linear", coordinate_transformation_mode=mode,
            nearest_mode="floor",
        )  # fmt: skip

    def pooled(self, value: str, bins: int, to: str = "") -> str:
        """Add the mean over bins × bins parts, which overlap where the sides are no multiple; return its name."""
        if bins == 1:
            return self.add("ReduceMean", [value], to, axes=[2, 3], keepdims=1)
        # Columns first: one multiplication for all channels, where rows first are one for each.
        columns = self.add("Transpose", [self._parts(self.side(value, 3), bins)], perm=[1, 0])
        by_columns = self.add("MatMul", [value, columns])
        return self.add("MatMul", [self._parts(self.side(value, 2), bins), by_columns], to)

    def enlarged(self, value: str, like: str, to: str = "") -> str:
        """Add bilinear enlargement to the size of another value, pixels lying between their borders; return its name.

        As two multiplications: for levels of a pyramid, of a few pixels, less work than ONNX's Resize makes of it.
        """
        rows, columns = (self._between(self.side(value, axis), self.side(like, axis)) for axis in (2, 3))
        by_rows = self.add("MatMul", [rows, value])
        return self.add("MatMul", [by_rows, self.add("Transpose", [columns], perm=[1, 0])], to)

    def model(self, inputs: str, outputs: Mapping[str, int], about: Mapping[str, str]) -> Any:
        """Return the model.

        Args:
            inputs: Name of the image.
            outputs: Channels of each output by name.
            about: What is written into the file beside the network.
        """
        kind = self._types.FLOAT
        image = self._helper.make_tensor_value_info(inputs, kind, [1, 3, "height", "width"])
        told = [
            self._helper.make_tensor_value_info(name, kind, [1, channels, f"{name}_height", f"{name}_width"])
            for name, channels in outputs.items()
        ]
        graph = self._helper.make_graph(self.nodes, "pspnet", [image], told, self.weights)
        opset = self._helper.make_opsetid("", OPSET)
        model = self._helper.make_model(graph, opset_imports=[opset], ir_version=IR_VERSION, producer_name="stillroom")
        self._helper.set_model_props(model, dict(about))
        return model

    def _parts(self, side: str, bins: int) -> str:
        """Return the name of a matrix (bins, side) of means, from floor(i side / bins) to ceil((i + 1) side / bins).

        ONNX has no adaptive pooling for sizes that are known only when it runs.
        """
        number = np.arange(bins, dtype=np.int64)[:, None]
        all_bins = self.numbers([bins], np.int64)
        first = self.add("Div", [self.add("Mul", [self.numbers(number, np.int64), side]), all_bins])
        to_next = self.add("Mul", [self.numbers(number + 1, np.int64), side])
        last = self.add("Div", [self.add("Add", [to_next, self.numbers([bins - 1], np.int64)]), all_bins])
        zero, one = self.numbers(0, np.int64), self.numbers(1, np.int64)
        place = self.add("Range", [zero, self.add("Squeeze", [side]), one])
        inside = self.add("And", [self.add("GreaterOrEqual", [place, first]), self.add("Less", [place, last])])
        share = self.add("Cast", [inside], to=self._types.FLOAT)
        count = self.add("Cast", [self.add("Sub", [last, first])], to=self._types.FLOAT)
        return self.add("Div", [share, count])

    def _between(self, few: str, many: str) -> str:
        """Return the name of a matrix (many, few) that interpolates linearly; beyond the outermost nothing changes."""
        number, unit = self._count_to(many), self.numbers(1.0, np.float32)
        few_float, many_float = (self.add("Cast", [side], to=self._types.FLOAT) for side in (few, many))
        half = self.numbers(0.5, np.float32)
        middle = self.add("Mul", [self.add("Add", [number, half]), self.add("Div", [few_float, many_float])])
        last = self.add("Squeeze", [self.add("Sub", [few_float, unit])])
        place = self.add("Clip", [self.add("Sub", [middle, half]), self.numbers(0.0, np.float32), last])
        column = self.add("Unsqueeze", [place, self.numbers([1], np.int64)])
        apart = self.add("Abs", [self.add("Sub", [column, self._count_to(few)])])
        return self.add("Relu", [self.add("Sub", [unit, apart])])

    def _count_to(self, side: str) -> str:
        """Return the name of the numbers from 0 up to below a size (1,), as float32."""
        zero, one = self.numbers(0, np.int64), self.numbers(1, np.int64)
        counted = self.add("Range", [zero, self.add("Squeeze", [side]), one])
        return self.add("Cast", [counted], to=self._types.FLOAT)

    def _name(self, kind: str) -> str:
        self._count += 1
        return f"{kind}{self._count}"
