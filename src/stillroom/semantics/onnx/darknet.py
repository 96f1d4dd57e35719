"""Networks with darknet's yolo heads in ONNX files of `stillroom export yolo`: their metadata and their boxes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F64
from stillroom.semantics.onnx.channels import channels_of_a_block, widen
from stillroom.semantics.onnx.layouts import DetectionRequest, Shape, Told, may_be

LARGEST_EXPONENT = 20.0  # of a box with invalid numbers
BOX_ROWS = 5
"""Numbers that come before those of the classes: x, y, w, h, objectness."""


@dataclass(frozen=True)
class Head:
    """What a yolo head's numbers are relative to.

    Attributes:
        anchors_px: Width and height of its anchors (A, 2) [px of the network's input].
        scale_xy: How far a centre may leave its cell; 1 is not at all.
    """

    anchors_px: tuple[tuple[float, float], ...]
    scale_xy: float


@dataclass(frozen=True)
class Heads:
    """The metadata of an ONNX file on its network's heads.

    Attributes:
        classes: Names of the classes, in order.
        heads: One for each output of the network.
    """

    classes: tuple[str, ...]
    heads: tuple[Head, ...]

    def as_metadata(self) -> dict[str, str]:
        """Return the metadata of an ONNX file, from which `from_metadata` restores it."""
        anchors = [" ".join(str(float(side)) for pair in head.anchors_px for side in pair) for head in self.heads]
        return {
            "classes": "\n".join(self.classes),
            "anchors_px": "\n".join(anchors),
            "scale_xy": "\n".join(str(float(head.scale_xy)) for head in self.heads),
        }

    @staticmethod
    def from_metadata(metadata: Mapping[str, str]) -> "Heads":
        """Return the heads from the metadata of an ONNX file.

        Raises:
            KeyError: It has no heads.
            ValueError: It is inconsistent.
        """
        classes = tuple(metadata["classes"].split("\n"))
        lines = [[float(side) for side in line.split()] for line in metadata["anchors_px"].split("\n")]
        scales = [float(scale) for scale in metadata["scale_xy"].split("\n")]
        anchors = [tuple(zip(line[0::2], line[1::2], strict=True)) for line in lines]
        heads = tuple(Head(pairs, scale) for pairs, scale in zip(anchors, scales, strict=True))
        return Heads(classes, heads)


class DarknetFile:
    """An ONNX file of `stillroom export yolo`.

    Attributes:
        path: The file.
        heads: Its heads.
    """

    def __init__(self, path: Path) -> None:
        """Read it.

        Raises:
            WeightsError: The file is absent, damaged, or none of `stillroom export yolo`.
        """
        import onnx
        from google.protobuf.message import DecodeError

        self.path = path
        try:
            self._model: Any = onnx.load_model_from_string(path.read_bytes())
            self.heads = Heads.from_metadata({entry.key: entry.value for entry in self._model.metadata_props})
        except OSError as error:
            raise WeightsError(f"{path}: {error.strerror or 'cannot be read'}") from error
        except (DecodeError, KeyError, ValueError) as error:
            raise WeightsError(
                f"{path}: not written by 'stillroom export yolo'; other networks plug in as semantics.kind=onnx-boxes"
            ) from error
        self._read_shapes()
        width = BOX_ROWS + len(self.heads.classes)
        promised = [len(head.anchors_px) * width for head in self.heads.heads]
        if [shape[1] for shape in self._output_shapes] != promised:
            raise WeightsError(f"{path}: damaged: its outputs {self._output_shapes} are not those of its heads")

    def fit_input(self, image_px: tuple[int, int], longer_side: float) -> None:
        """Give the input the proportions of an image, as nearly as whole cells of the coarsest head allow.

        A square input stretches an image of 4:3, and costs more than one that does not.

        Args:
            image_px: Width and height of the images.
            longer_side: Longer side of the input as a share of its present one; both are rounded to whole cells.
        """
        scale = longer_side * max(self._input_shape[2:]) / max(image_px)
        rows, columns = (max(round(side * scale / self._cell_px), 1) * self._cell_px for side in image_px[::-1])
        graph = self._model.graph
        for value, cell_px in zip((*graph.input, *graph.output), (1, *self._cells_px), strict=True):
            _, _, height, width = value.type.tensor_type.shape.dim
            height.dim_value, width.dim_value = rows // cell_px, columns // cell_px
        self._read_shapes()

    def cut_to(self, classes: Sequence[int]) -> bytes:
        """Return the ONNX model reduced to some classes, in their order, and made for this machine.

        One class instead of 80 saves a twentieth of the work, channels in whole blocks up to a fifth.

        Args:
            classes: The numbers of the classes.
        """
        import onnx

        model = onnx.ModelProto()
        model.CopyFrom(self._model)
        constants = {constant.name: constant for constant in model.graph.initializer}
        makers = {name: node for node in model.graph.node for name in node.output}
        rows_of_anchor = [*range(BOX_ROWS), *(BOX_ROWS + number for number in classes)]
        n_all = BOX_ROWS + len(self.heads.classes)
        for head, output in zip(self.heads.heads, model.graph.output, strict=True):
            rows = [anchor * n_all + row for anchor in range(len(head.anchors_px)) for row in rows_of_anchor]
            node = makers[output.name]
            while node.op_type != "Conv":  # an activation, and the output's name
                node = makers[node.input[0]]
            for name in node.input[1:]:
                whole = onnx.numpy_helper.to_array(constants[name])
                constants[name].CopyFrom(onnx.numpy_helper.from_array(whole[rows], name))
            output.type.tensor_type.shape.dim[1].dim_value = len(rows)
        widen(model, channels_of_a_block())
        return bytes(model.SerializeToString())

    def layout(self, asked: DetectionRequest) -> "DarknetHeads":
        """Return the decoder of the network's outputs.

        Args:
            asked: The wanted classes; `n_classes` of them after it was cut.
        """
        return DarknetHeads(self.heads, self._input_shape, self._output_shapes, asked)

    def _read_shapes(self) -> None:
        """Read the shapes of input and outputs, and how many pixels of the input each head's cells measure."""
        shapes = [self._shape(value) for value in (*self._model.graph.input, *self._model.graph.output)]
        self._input_shape, self._output_shapes = shapes[0], shapes[1:]
        self._cells_px = [self._input_shape[2] // shape[2] for shape in self._output_shapes]
        self._cell_px = max(self._cells_px, default=1)

    def _shape(self, value: Any) -> tuple[int, ...]:
        shape = tuple(side.dim_value for side in value.type.tensor_type.shape.dim)
        if len(shape) != 4 or min(shape) < 1:
            raise WeightsError(f"{self.path}: '{value.name}' is of shape {shape}; all four sides must be known")
        return shape


class DarknetHeads:
    """The layout `darknet`: for each head (1, A (5 + C), h, w) of raw numbers, A its anchors."""

    def __init__(
        self, heads: Heads, input_shape: Sequence[int], output_shapes: Sequence[Sequence[int]], asked: DetectionRequest
    ) -> None:
        """Take the heads of a network, which may have been cut to fewer classes than its file names.

        Args:
            heads: The heads of the file.
            input_shape: 1, channels, height, width of the input.
            output_shapes: 1, channels, height, width of each head's output; the channels do not count.
            asked: The wanted classes; boxes are in shares of its input by themselves.
        """
        self._asked = asked
        self._width = BOX_ROWS + asked.n_classes
        pairs = list(zip(heads.heads, output_shapes, strict=True))
        self._shapes = [(1, len(head.anchors_px) * self._width, *shape[2:]) for head, shape in pairs]
        side_px = (input_shape[3], input_shape[2])
        self._cells = np.concatenate([_cells_of(head, shape[2], shape[3], side_px) for head, shape in pairs])
        self._columns = [BOX_ROWS + number for number in asked.classes]

    @property
    def expected(self) -> str:
        """The outputs' shapes in words."""
        return ", ".join(str(shape) for shape in self._shapes)

    def fits(self, shapes: Sequence[Shape]) -> bool:
        """Return whether each head has an output."""
        pairs = zip(shapes, self._shapes, strict=False)
        return len(shapes) == len(self._shapes) and all(may_be(shape, *wanted) for shape, wanted in pairs)

    def read(self, outputs: Sequence[Any]) -> Told:
        """Return the boxes; one that is likely of two classes is returned twice."""
        width, least = self._width, self._asked.confidence
        rows = [
            raw.reshape(-1, width, raw.shape[2] * raw.shape[3]).transpose(0, 2, 1).reshape(-1, width) for raw in outputs
        ]
        raw_rows = np.concatenate(rows)
        # Objectness bounds confidence from above, and few cells pass.
        limit = np.log(least / max(1.0 - least, 1e-12))
        likely = np.flatnonzero(raw_rows[:, 4] >= limit)
        values = raw_rows[likely].astype(np.float64)
        confidence = _sigmoid(values[:, 4:5]) * _sigmoid(values[:, self._columns])
        which, label = np.nonzero(confidence >= least)
        values, cells = values[which], self._cells[likely[which]]
        center = cells[:, 0] + _sigmoid(values[:, :2]) * cells[:, 1]
        half = 0.5 * np.exp(np.minimum(values[:, 2:4], LARGEST_EXPONENT)) * cells[:, 2]
        return Told(np.concatenate([center - half, center + half], axis=1), confidence[which, label], label)


def _cells_of(head: Head, rows: int, columns: int, side_px: tuple[int, int]) -> F64:
    """Return for each possible box of a head its cell's corner and span and its anchor's size, (N, 3, 2) in [0, 1].

    Anchors, rows, columns: the order in which `DarknetHeads.read` reads them.
    """
    table = np.zeros((len(head.anchors_px), rows, columns, 3, 2))
    row, column = np.indices((rows, columns))
    table[..., 0, :] = np.stack([column, row], axis=2) - 0.5 * (head.scale_xy - 1.0)
    table[..., 1, :] = head.scale_xy
    table[..., :2, :] /= (columns, rows)
    table[..., 2, :] = np.array(head.anchors_px)[:, None, None] / side_px
    return table.reshape(-1, 3, 2)


def _sigmoid(x: F64) -> F64:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))
