"""Networks in ONNX files that take one image: opening them, and their input format."""

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.data.locations import model_folders, model_path
from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32

COLORS = 3
INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}


def find_model(named: Path) -> Path:
    """Return a network's file; a bare name is looked up in the model folders.

    Raises:
        WeightsError: There is none; the message lists the folders.
    """
    found = named if named.is_file() else model_path(str(named))
    if found is not None and found.is_file():
        return found
    if named.is_absolute():
        raise WeightsError(f"no such network: {named}; set semantics.model to an ONNX file")
    looked = [str(named), *(str(place / named) for place in model_folders())]
    raise WeightsError(
        f"no such network: {', '.join(looked)}; set semantics.model to an ONNX file, "
        f"or STILLROOM_MODELS to the folder that holds {named.name}"
    )


@dataclass(frozen=True)
class ImageInput:
    """The one input of a network that takes an image.

    Attributes:
        name: Its name in the network.
        dtype: Type of its numbers.
        rows, columns: Its size [px]; None where the file leaves it open.
        channels_last: Whether it is (height, width, 3) and not (3, height, width).
        batched: Whether an axis of length 1 comes before these.
    """

    name: str
    dtype: Any
    rows: int | None
    columns: int | None
    channels_last: bool
    batched: bool = True

    def blob(self, planes: F32) -> Any:
        """Return the planes of an image (3, rows, columns) float32 as the network takes them."""
        ordered = planes.transpose(1, 2, 0) if self.channels_last else planes
        return np.ascontiguousarray(ordered[None] if self.batched else ordered, dtype=self.dtype)


def image_input(session: Any, name: object, may_lack_batch: bool = False) -> ImageInput:
    """Return the input of a network that takes one image.

    Args:
        session: The opened network.
        name: What to call it in messages, such as its path.
        may_lack_batch: Whether (3, height, width) will do, too.

    Raises:
        WeightsError: The network takes something else.
    """
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(node.name for node in inputs)
        raise WeightsError(f"{name}: takes {len(inputs)} inputs ({names}); it must take one image")
    node = inputs[0]
    if node.type not in INPUT_TYPES:
        raise WeightsError(f"{name}: takes {node.type}; it must take {', '.join(INPUT_TYPES)}")
    shape = list(node.shape)
    batched = not (may_lack_batch and len(shape) == 3)
    axes = shape[1:] if batched else shape
    first, last = (len(axes) == 3 and axes[axis] == COLORS for axis in (0, 2))
    if not (first or last) or (batched and isinstance(shape[0], int) and shape[0] > 1):
        raise WeightsError(
            f"{name}: its input '{node.name}' is of shape {node.shape}; "
            "it must be (1, 3, height, width) or (1, height, width, 3)"
        )
    channels_last = last and not first
    rows, columns = (side if isinstance(side, int) else None for side in (axes[:2] if channels_last else axes[1:]))
    return ImageInput(node.name, INPUT_TYPES[node.type], rows, columns, channels_last, batched)


def open_file(path: Path) -> Any:
    """Return onnxruntime's session of a file.

    Raises:
        WeightsError: There is no such file, or it is no network that can be run.
    """
    if not path.is_file():
        raise WeightsError(f"{path}: no such file; set semantics.model to an ONNX file")
    try:
        return on_one_thread(str(path))
    except failures() as error:
        raise WeightsError(f"{path}: not an ONNX network that can be run ({first_line(error)})") from error


@functools.lru_cache(maxsize=2)
def open_content(model: bytes, name: object) -> Any:
    """Return onnxruntime's session of a file's content, opened once for several runs after each other.

    Args:
        model: The content.
        name: What to call the network in messages, such as its path.

    Raises:
        WeightsError: It is no network that can be run.
    """
    try:
        return on_one_thread(model)
    except failures() as error:
        raise WeightsError(f"{name}: not an ONNX network that can be run ({first_line(error)})") from error


def on_one_thread(model: str | bytes) -> Any:
    """Return onnxruntime's session of a file, or of a file's content.

    On one thread the same image gives the same numbers, and tracking keeps its cores.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # errors are raised, and reported in one line
    # Falling back to what has just failed would only print.
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"], enable_fallback=0)


def failures() -> tuple[type[Exception], ...]:
    """Return what onnxruntime raises; its errors have no common base."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    names = (
        "Fail", "InvalidArgument", "InvalidGraph", "InvalidProtobuf", "NoModel", "NoSuchFile", "NotImplemented",
        "RuntimeException",
    )  # fmt: skip
    # What it quotes of a damaged file may be no text.
    return (*(getattr(state, name) for name in names), UnicodeDecodeError)


def first_line(error: Exception) -> str:
    """Return the first line of an error's message, shortened to fit one line."""
    return str(error).strip().splitlines()[0][:200]
