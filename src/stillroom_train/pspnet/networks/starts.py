"""Weights to start from: a trained backbone, a trained head, OpenMMLab's checkpoint."""

import pickle
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.networks.steps import AUXILIARY, Architecture
from stillroom_train.pspnet.networks.torch_network import torch_or_error

HEAD_OF_DEEPLAB = {"asp": "decode_head.local", "img": "decode_head.bins.1", "cls": "decode_head.conv_seg"}
"""Which convolution of DeepLabv3-MobileNetV2's head becomes which of ours; its `prj` needs another order."""


def backbone_weights(path: Path, network: Architecture) -> dict[str, F32]:
    """Return the weights of a backbone that lie in an .npz file under their own names.

    Raises:
        WeightsError: The file cannot be read, or a weight is absent or of another shape.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            found = {name: np.asarray(stored[name], dtype=np.float32) for name in stored.files}
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise WeightsError(f"{path}: cannot be read as the weights of a backbone ({error})") from error
    wanted = {name: shape for name, shape in network.shapes().items() if name.startswith("backbone.")}
    return _fitting(found, wanted, path)


def deeplab_head(path: Path, network: Architecture) -> dict[str, F32]:
    """Return weights with which PSPNet-MobileNetV2's head says what DeepLabv3's head says, to start from there.

    The pyramid's parts count for nothing yet, and the depthwise convolution passes on what it gets.

    Raises:
        WeightsError: The file is no such network.
    """
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load(str(path))
    except (OSError, ValueError, DecodeError) as error:
        raise WeightsError(f"{path}: cannot be read as an ONNX file ({error})") from error
    stored = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    found: dict[str, F32] = {}
    for theirs, ours in HEAD_OF_DEEPLAB.items():
        for part in ("weight", "bias"):
            found[f"{ours}.{part}"] = _named(stored, f"n.{theirs}.{part}", path)
    shapes = network.shapes()
    projection = _named(stored, "n.prj.weight", path)
    whole = projection.shape[1] // 2  # theirs has the mean of the whole image first
    found["decode_head.bottleneck.1.weight"] = projection[:, :whole]
    found["decode_head.bottleneck.local.weight"] = projection[:, whole:]
    found["decode_head.bottleneck.local.bias"] = _named(stored, "n.prj.bias", path)
    idle = [name for name in shapes if name.startswith(("decode_head.bottleneck.", "decode_head.around."))]
    found |= {name: np.zeros(shapes[name], dtype=np.float32) for name in idle if name not in found}
    found["decode_head.around.weight"][:, :, 1, 1] = 1.0
    return _fitting(found, {name: shapes[name] for name in found}, path)


def checkpoint_weights(path: Path, network: Architecture, part: str = "result") -> dict[str, F32]:
    """Return the weights in a checkpoint of OpenMMLab's or of ours, read without running what a pickle may contain.

    Args:
        path: The file.
        network: Whose weights they should be.
        part: Of our own: "result", what is told as the result; "mean", what learning has come to; "start", where it
            began. Others have one set of weights, which is returned for any part.

    Raises:
        MissingExtraError: torch is not installed.
        WeightsError: The file cannot be read so, or a weight is absent or of another shape.
    """
    torch = torch_or_error()
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, pickle.UnpicklingError, EOFError) as error:
        reason = str(error).strip().splitlines()[0]
        raise WeightsError(f"{path}: cannot be read as a checkpoint of weights alone ({reason})") from error
    return named_weights(stored, network, path, part)


def named_weights(stored: Any, network: Architecture, source: Path, part: str = "result") -> dict[str, F32]:
    """Return the weights of a checkpoint's mapping under the network's names.

    Weights lie at the top or under "state_dict", and may bear the prefix "module." of parallel training. Counters of
    batch norms are left aside. Without the auxiliary head, as in files for inference, it keeps what it has.

    Raises:
        WeightsError: A weight is absent or of another shape.
    """
    inner = stored.get("state_dict", stored) if isinstance(stored, Mapping) else None
    if not isinstance(inner, Mapping):
        raise WeightsError(f"{source}: holds no weights by name")
    found = {
        str(name).removeprefix("module."): np.asarray(value.detach().cpu().float().numpy())
        for name, value in inner.items()
        if hasattr(value, "detach") and not str(name).endswith("num_batches_tracked")
    }
    if isinstance(own := stored.get(part), Mapping):
        found |= {str(name): np.asarray(value.detach().cpu().float().numpy()) for name, value in own.items()}
    has_auxiliary = any(name.startswith(AUXILIARY) for name in found)
    return _fitting(found, network.shapes(has_auxiliary), source)


def _fitting(found: Mapping[str, F32], wanted: Mapping[str, tuple[int, ...]], source: Path) -> dict[str, F32]:
    for name, shape in wanted.items():
        if name not in found:
            raise WeightsError(f"{source}: has no weights '{name}'; it is of another network")
        if found[name].shape != shape:
            raise WeightsError(f"{source}: '{name}' is of shape {found[name].shape}, not {shape}; another network's")
    return {name: np.asarray(found[name], dtype=np.float32) for name in wanted}


def _named(stored: Mapping[str, Any], name: str, source: Path) -> F32:
    if name not in stored:
        raise WeightsError(f"{source}: has no weights '{name}'; DeepLabv3-MobileNetV2 has")
    return np.asarray(stored[name], dtype=np.float32)
