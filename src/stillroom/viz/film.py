"""Frames as a video file."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np

from stillroom.errors import StillroomError
from stillroom.geometry.arrays import U8

# Frames as a video file.


CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
"""OpenCV includes both codecs."""


class VideoFile:
    """Writes frames as they come; the file is made with the first, and is whole once closed."""

    def __init__(self, path: Path, fps: float) -> None:
        """Store the settings.

        Args:
            path: The file, `.mp4` or `.avi`; its folder is made.
            fps: Frames per second [1/s].

        Raises:
            StillroomError: It is neither.
        """
        if path.suffix.lower() not in CODECS:
            raise StillroomError(f"{path}: no kind of video that can be written; name it {' or '.join(CODECS)}")
        self._path, self._fps = path, fps
        self._writer: Any = None
        self._shape: tuple[int, ...] = ()

    def __enter__(self) -> "VideoFile":
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def add(self, rgb: U8) -> None:
        """Write a frame (H, W, 3), RGB; all are of one size.

        Raises:
            StillroomError: The file cannot be written.
        """
        if self._writer is None:
            self._open(rgb)
        assert rgb.shape == self._shape, f"a frame of {rgb.shape} in a video of {self._shape}"
        self._writer.write(np.ascontiguousarray(rgb[..., ::-1]))

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.release()
            self._writer = None

    def _open(self, rgb: U8) -> None:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StillroomError(f"{self._path}: cannot be written ({error.strerror})") from error
        code = cv2.VideoWriter.fourcc(*CODECS[self._path.suffix.lower()])
        self._shape = rgb.shape
        self._writer = cv2.VideoWriter(str(self._path), code, self._fps, (rgb.shape[1], rgb.shape[0]))
        if not self._writer.isOpened():
            raise StillroomError(f"{self._path}: this OpenCV cannot write such a video; try another ending or folder")


# A picture of many pictures.


GAP_PX = 6
LETTERS = 0.45
PAPER, INK = 255, (34, 38, 44)
LABEL_PX = 20


def contact_sheet(columns: Sequence[tuple[str, Sequence[U8]]], width_px: int = 320, per_row: int = 4) -> U8:
    """Lay labelled stacks of pictures out on white paper, side by side and row by row.

    Args:
        columns: Each a label and the pictures (H, W, 3) below it; all pictures of one shape, all stacks of one height.
        width_px: Width of a picture on the sheet.
        per_row: How many stacks stand side by side.

    Returns:
        The sheet (h, w, 3); a small white one where there is nothing to show.
    """
    if not columns:
        return np.full((LABEL_PX, width_px, 3), PAPER, dtype=np.uint8)
    stacks = [_stack(label, pictures, width_px) for label, pictures in columns]
    height, width = stacks[0].shape[:2]
    n_across = min(per_row, len(stacks))
    n_down = -(-len(stacks) // n_across)
    size = n_down * (height + GAP_PX) + GAP_PX, n_across * (width + GAP_PX) + GAP_PX, 3
    sheet = np.full(size, PAPER, dtype=np.uint8)
    for place, stack in enumerate(stacks):
        top = GAP_PX + (place // n_across) * (height + GAP_PX)
        left = GAP_PX + (place % n_across) * (width + GAP_PX)
        sheet[top : top + height, left : left + width] = stack
    return sheet


def _stack(label: str, pictures: Sequence[U8], width_px: int) -> U8:
    """Return pictures on top of each other with a label above."""
    head = np.full((LABEL_PX, width_px, 3), PAPER, dtype=np.uint8)
    cv2.putText(head, label, (2, LABEL_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, LETTERS, INK, 1, cv2.LINE_AA)
    parts = [head]
    for picture in pictures:
        size = width_px, round(picture.shape[0] * width_px / picture.shape[1])
        parts.append(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return np.concatenate(parts)
