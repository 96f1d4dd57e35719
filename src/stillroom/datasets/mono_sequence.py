"""Sequences of single images: those that have no other, and those of which no more is to be used."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillroom.data.image import MonoImage
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.image_sequence import PROBED_FRAMES, camera_size_words, read_rgb, remark_gaps, size_words
from stillroom.datasets.recording import DatasetView, Recording
from stillroom.errors import CalibrationError, DatasetError, FrameError
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset


@dataclass(frozen=True)
class MonoSequence(Recording):
    """A `Dataset` of single images on disk.

    Attributes:
        name: Short name, used for the results folder.
        camera: The calibration of the images as taken.
        camera_source: One line that says where it comes from.
        timestamps_s: Times of the images (N,) float64 [s].
        files: The images.
        groundtruth: Poses of the camera, where there are any.
        groundtruth_flaw: Why the ground truth that lies with the images cannot be used; empty where it can.
    """

    name: str
    camera: Camera
    camera_source: str
    timestamps_s: F64
    files: tuple[Path, ...]
    groundtruth: Trajectory | None = None
    groundtruth_flaw: str = ""
    unpaired_s: F64 = field(default_factory=lambda: np.zeros(0))
    sensor: Sensor = Sensor.MONOCULAR

    def load(self, index: int) -> MonoImage:
        """Read image `index`.

        Raises:
            IndexError: There is no such image.
            FrameError: The file is missing, does not decode, or has another size than the sequence.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: no image {index}; there are {len(self)}, from 0")
        rgb = read_rgb(self.files[index])
        if rgb.shape[:2] != (self.camera.height, self.camera.width):
            raise FrameError(
                f"{self.files[index]}: {size_words(rgb)} pixels; the sequence has {camera_size_words(self.camera)}"
            )
        return MonoImage(float(self.timestamps_s[index]), rgb, index, self.files[index].stem)

    def checked(self, folder: Path) -> "MonoSequence":
        """Return itself after looking at its first images, and warning about gaps.

        Raises:
            DatasetError: None of them can be used.
            CalibrationError: They are of another size than the camera's.
        """
        require_size(self.files, self.camera, self.camera_source)
        require_usable(folder, self)
        remark_gaps(self.name, self.timestamps_s)
        return self


class WithoutDepth(DatasetView):
    """A `Dataset` that shows only the colour, or the left, image of another: as a single camera would take it."""

    @property
    def sensor(self) -> Sensor:
        """A single camera."""
        return Sensor.MONOCULAR

    def load(self, index: int) -> MonoImage:
        """Return image `index`.

        Raises:
            IndexError: There is no such image.
            FrameError: It cannot be used.
        """
        image = self.inner.load(index)
        return MonoImage(image.timestamp_s, image.rgb, image.index, image.name, image.truth)


def require_size(files: tuple[Path, ...], camera: Camera, source: str) -> None:
    """Refuse a calibration of images of another size, told by the first image that can be read.

    Raises:
        CalibrationError: It is of another size than the camera's.
    """
    for path in files[:PROBED_FRAMES]:
        try:
            rgb = read_rgb(path)
        except FrameError:
            continue
        if rgb.shape[:2] != (camera.height, camera.width):
            raise CalibrationError(
                f"{path}: {size_words(rgb)} pixels, but the camera ({source}) has {camera_size_words(camera)}; "
                "give the calibration of this sequence"
            )
        return


def require_usable(folder: Path, sequence: Dataset) -> None:
    """Refuse a sequence of which none of the first images can be used.

    Raises:
        DatasetError: None can; the message says what is wrong with the first.
    """
    errors: list[FrameError] = []
    for index in range(min(PROBED_FRAMES, len(sequence))):
        try:
            sequence.load(index)
        except FrameError as error:
            errors.append(error)
        else:
            return
    raise DatasetError(f"{folder}: none of the first {len(errors)} frames can be used; {errors[0]}")
