"""Frames as a video file."""

from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np

from stillroom.errors import StillroomError
from stillroom.geometry.arrays import U8

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
"""OpenCV brings both along."""


class VideoFile:
    """Writes frames as they come; the file is made with the first, and is whole once closed."""

    def __init__(self, path: Path, fps: float) -> None:
        """Take note of what is wanted.

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
