"""A recorded sequence as a camera: `camera:replay:FOLDER`, and with faults `camera:replay:FOLDER?missing=3&gone=20`.

The images come one after the other as they are asked for; the times at which they are due are those that they have, and
whoever plays them at a camera's pace heeds these.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from stillroom.cameras.faults import Faults
from stillroom.cameras.kind import CameraKind
from stillroom.data.image import Image
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import groundtruth_flaw, sensor_of
from stillroom.errors import CameraError, ConfigError, FrameError
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset

NO_FAULTS = Faults()


class ReplayCamera:
    """Plays a data set as a `CameraStream`, from the start each time it is entered."""

    comes_in_time = False

    def __init__(
        self, dataset: Dataset, faults: Faults = NO_FAULTS, wait: Callable[[float], object] = time.sleep
    ) -> None:
        """Play a data set.

        Args:
            dataset: The images.
            faults: What goes wrong with the camera.
            wait: Waits some seconds for a late image.
        """
        self._dataset, self._faults, self._wait = dataset, faults, wait
        self._coming: Iterator[int] = iter(())
        self._is_gone = False

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self._dataset.name

    @property
    def sensor(self) -> Sensor:
        """What kind of camera took the images."""
        return sensor_of(self._dataset)

    @property
    def camera(self) -> Camera:
        """The calibration in force."""
        return self._dataset.camera

    @property
    def camera_source(self) -> str:
        """Where the calibration comes from."""
        return self._dataset.camera_source

    @property
    def groundtruth(self) -> Trajectory | None:
        """True poses as the data set gives them."""
        return self._dataset.groundtruth

    @property
    def groundtruth_at_camera(self) -> Trajectory | None:
        """The same moved to the camera, where they are those of another body."""
        return self._dataset.groundtruth_at_camera

    @property
    def groundtruth_flaw(self) -> str:
        """Why the ground truth that lies with the images cannot be used; empty where it can, or there is none."""
        return groundtruth_flaw(self._dataset)

    def __enter__(self) -> Self:
        """Begin with the first image."""
        self._coming, self._is_gone = iter(self._faults.order(len(self._dataset))), False
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Deliver nothing more."""
        self._coming = iter(())

    def next(self) -> Image | None:
        """Return the next image at once; None after the last one.

        Raises:
            FrameError: This one cannot be used.
            CameraError: The cable is pulled out.
        """
        if self._is_gone:
            raise CameraError(f"camera:replay: {self.name}: the camera is gone")
        place = next(self._coming, None)
        if place is None:
            return None
        last = self._faults.gone_after
        self._is_gone = last is not None and place >= last
        self._wait_for(place)
        if place in self._faults.unreadable:
            raise FrameError(f"camera:replay: {self.name}: image {place} arrived damaged")
        return self._dataset.load(place)

    def _wait_for(self, place: int) -> None:
        wait_s = self._faults.late.get(place, 0.0)
        if wait_s > 0:
            self._wait(wait_s)


def open_replay(text: str) -> ReplayCamera:
    """Open a folder, or whatever else `open_dataset` opens, as a camera; after a `?` stand its faults.

    Raises:
        ConfigError: No folder is named, or the faults are malformed.
        DatasetError, CalibrationError: It cannot be opened.
    """
    folder, mark, faults = text.rpartition("?")
    if not mark or (text and Path(text).exists()):
        folder, mark, faults = text, "", ""
    if not folder:
        raise ConfigError(f"camera:replay: name what is to be played: {KIND.usage}")
    return ReplayCamera(open_dataset(folder), Faults.read(faults) if mark else NO_FAULTS)


KIND = CameraKind(
    "replay",
    "camera:replay:FOLDER[?FAULTS]",
    "a recorded sequence, played as a camera",
    open_replay,
)
