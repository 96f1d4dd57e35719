"""Keeps what a camera sees as a folder in TUM's layout, which `open_dataset` opens.

::

    rgb/1305031229.528748.png    rgb.txt            camera.toml
    depth/1305031229.528748.png  depth.txt          groundtruth.txt, where the stream has it

A PNG takes longer to write than an image to come, now and then, so a thread of its own writes; images wait for it in a
queue that has an end, and are not compressed while it is more than half full, which is eight times as fast. Lists name
an image once its files are whole, so that whatever ends a recording, what they list can be read.
"""

import queue
import threading
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

import cv2
import numpy as np

from stillroom.data.image import Image
from stillroom.data.replacing import cannot_be_written
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.bonn import NAME_PREFIX
from stillroom.datasets.camera_file import CAMERA_FILE_NAME, write_camera
from stillroom.datasets.image_sequence import GROUNDTRUTH_NAME
from stillroom.datasets.tum import DEPTH_LIST_NAME, RGB_LIST_NAME
from stillroom.errors import FrameError, StillroomError
from stillroom.geometry.arrays import U16
from stillroom.protocols import CameraStream

QUEUE_LENGTH = 60
"""Two seconds at 30 Hz, 130 MB of images 640×480."""
COMPRESSED: tuple[int, ...] = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
STORED: tuple[int, ...] = (cv2.IMWRITE_PNG_COMPRESSION, 0)
if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # one filter in place of a choice for each row, which takes half the time
    COMPRESSED += (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP)
    STORED += (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
MOST_UNITS = 65535


class TumRecorder:
    """Writes images into a folder; entered before the first image, left after the last, which waits for the writer.

    Attributes:
        n_written: Images that are whole in the folder.
        n_dropped: Images that came while the queue was full.
        n_not_later: Images whose time was not after that of the image before, which no list can name.
    """

    def __init__(self, folder: Path, camera: CameraStream, length: int = QUEUE_LENGTH) -> None:
        """Prepare to write.

        Args:
            folder: An empty folder.
            camera: The camera, entered. One whose images do not come in time waits while the queue is full.
            length: How many images the queue takes.
        """
        self.n_written = self.n_dropped = self.n_not_later = 0
        self._folder, self._stream = folder, camera
        self._queue: queue.Queue[Image | None] = queue.Queue(length)
        self._writer = threading.Thread(target=self._write_all, name="recorder")
        self._lists: dict[str, TextIO] = {}
        self._last_s = -np.inf
        self._error: StillroomError | None = None

    def __enter__(self) -> Self:
        """Write what is known before the first image, and start the writer.

        Raises:
            StillroomError: It cannot be written.
        """
        try:
            write_camera(self._stream.camera, self._folder / CAMERA_FILE_NAME)
            for folder, name in (("rgb", RGB_LIST_NAME), ("depth", DEPTH_LIST_NAME)):
                (self._folder / folder).mkdir()
                self._lists[folder] = (self._folder / name).open("w", encoding="utf-8", newline="\n")
                self._lists[folder].write("# timestamp filename\n")
            groundtruth = self._groundtruth()
            if groundtruth is not None:
                groundtruth.write_tum(self._folder / GROUNDTRUTH_NAME)
        except (OSError, StillroomError) as error:
            self._close_lists()
            raise cannot_be_written(self._folder, error) if isinstance(error, OSError) else error from error
        self._writer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Write what waits in the queue, and close the lists.

        Raises:
            StillroomError: An image could not be written.
        """
        self._queue.put(None)
        self._writer.join()
        self._close_lists()
        if error is None:
            self._require_no_error()

    def keep(self, image: Image) -> bool:
        """Hand an image to the writer; return whether it will be written.

        Raises:
            FrameError: It is not of the camera's size.
            StillroomError: An earlier one could not be written.
        """
        self._require_no_error()
        size = (self._stream.camera.height, self._stream.camera.width)
        if image.rgb.shape[:2] != size or image.depth_m.shape != size:
            raise FrameError(f"{image.rgb.shape[1]}×{image.rgb.shape[0]} pixels; the camera has {size[1]}×{size[0]}")
        if not image.timestamp_s > self._last_s:
            self.n_not_later += 1
            return False
        try:
            self._queue.put(image, block=not self._stream.comes_in_time)
        except queue.Full:
            self.n_dropped += 1
            return False
        self._last_s = image.timestamp_s
        return True

    def _require_no_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _groundtruth(self) -> Trajectory | None:
        """Return the camera's poses; in a folder that is called like one of Bonn's, those from which it is told."""
        given, at_camera = self._stream.groundtruth, self._stream.groundtruth_at_camera
        return given if at_camera is None or self._folder.resolve().name.startswith(NAME_PREFIX) else at_camera

    def _write_all(self) -> None:
        """Write until None comes; after an error, images are taken and forgotten, so that nobody waits forever."""
        while (image := self._queue.get()) is not None:
            if self._error is None:
                try:
                    self._write(image)
                except OSError as error:
                    self._error = cannot_be_written(error.filename or self._folder, error)
                except (cv2.error, MemoryError) as error:
                    self._error = StillroomError(f"{self._folder}: an image cannot be written ({error})")

    def _write(self, image: Image) -> None:
        name = f"{image.timestamp_s:.6f}"
        if (self._folder / "rgb" / f"{name}.png").exists():  # two images within a microsecond
            name = repr(image.timestamp_s)
        units = depth_in_units(image, self._stream.camera.depth_factor)
        way = STORED if 2 * self._queue.qsize() > self._queue.maxsize else COMPRESSED
        for folder, pixels in (("rgb", cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR)), ("depth", units)):
            encoded = cv2.imencode(".png", pixels, way)[1]
            (self._folder / folder / f"{name}.png").write_bytes(encoded.tobytes())
        for folder, lines in self._lists.items():
            lines.write(f"{image.timestamp_s!r} {folder}/{name}.png\n")  # all digits: times make trajectories
            lines.flush()
        self.n_written += 1

    def _close_lists(self) -> None:
        for lines in self._lists.values():
            lines.close()


def depth_in_units(image: Image, depth_factor: float) -> U16:
    """Return depth (H, W) uint16 in units of 1/depth_factor m; 0 where it is unknown or more than 16 bits hold."""
    units = np.rint(image.depth_m * np.float32(depth_factor))
    units[units >= MOST_UNITS] = 0.0
    return np.asarray(units, dtype=np.uint16)
