"""What a trained network says of all classes, for another to learn from (Hinton et al., 2015)."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32, U8
from stillroom.semantics.onnx.onnx_session import on_one_thread

LONGER_SIDES_PX = (513,)
"""Sizes at which the teacher looks at a picture; what it says is averaged over them, and over the mirrored picture."""

PART_PX = 8
"""Pixels of the picture per pixel of what is kept."""


class Teacher:
    """A network in an ONNX file: `image` (1, 3, H, W) RGB in [−1, 1], any sides 16k + 1, to `logits` (1, 21, H, W)."""

    def __init__(self, path: Path, cache: Path, longer_sides_px: Sequence[int] = LONGER_SIDES_PX) -> None:
        """Load it.

        Args:
            path: The ONNX file.
            cache: Folder for what it said, so that it need not say it again.
            longer_sides_px: Sizes at which it looks [px].

        Raises:
            WeightsError: The file is absent or no network.
        """
        if not path.is_file():
            raise WeightsError(f"{path}: no such file; name the teacher's ONNX file")
        self._session = _session(path)
        self._cache = cache
        self._sides = tuple(longer_sides_px)
        self._sign = hashlib.sha256(path.read_bytes() + repr(self._sides).encode()).hexdigest()[:12]

    def __call__(self, rgb: U8) -> Any:
        """Return the probability of each class (h, w, classes) float16, at an eighth of the picture's size."""
        shape = np.array(rgb.shape).tobytes()
        stored = self._cache / f"{hashlib.sha256(rgb.tobytes() + shape).hexdigest()[:20]}-{self._sign}.npy"
        if stored.is_file():
            return np.load(stored, allow_pickle=False)
        said = self._said(rgb).astype(np.float16)
        self._cache.mkdir(parents=True, exist_ok=True)
        part = stored.with_suffix(".part.npy")
        np.save(part, said)
        part.replace(stored)
        return said

    def _said(self, rgb: U8) -> F32:
        rows, columns = (max(round(side / PART_PX), 1) for side in rgb.shape[:2])
        total = np.zeros((rows, columns, 1), dtype=np.float32)
        for longer_px in self._sides:
            height, width = (
                max(round(side * longer_px / max(rgb.shape[:2]) / 16), 1) * 16 + 1 for side in rgb.shape[:2]
            )
            fit = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32) / 127.5 - 1.0
            for turned in (fit, fit[:, ::-1]):
                blob = np.ascontiguousarray(turned.transpose(2, 0, 1)[None])
                likely = _likely(self._session.run(None, {"image": blob})[0][0, :, ::2, ::2])
                likely = likely if turned is fit else likely[:, ::-1]
                total = total + _shrunk(likely, columns, rows)
        return np.asarray(total / (2 * len(self._sides)), dtype=np.float32)


def _likely(logits: Any) -> F32:
    """Return softmax of (classes, h, w) as (h, w, classes)."""
    exponent = np.exp(logits - logits.max(axis=0))
    return np.ascontiguousarray((exponent / exponent.sum(axis=0)).transpose(1, 2, 0), dtype=np.float32)


def _shrunk(likely: F32, columns: int, rows: int) -> F32:
    channels = [
        cv2.resize(np.ascontiguousarray(likely[..., c]), (columns, rows), interpolation=cv2.INTER_AREA)
        for c in range(likely.shape[2])
    ]
    return np.stack(channels, axis=-1)


def _session(path: Path) -> Any:
    try:
        return on_one_thread(str(path))
    except Exception as error:
        raise WeightsError(f"{path}: cannot be read as an ONNX network") from error
