"""A sequence of pairs of images on disk, rectified as they are read where they are not."""

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillroom.data.image import StereoImage
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.image_sequence import camera_size_words, read_gray, read_rgb, remark_gaps, size_words
from stillroom.datasets.mono_sequence import require_size, require_usable
from stillroom.datasets.recording import Recording
from stillroom.errors import FrameError
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera
from stillroom.geometry.stereo_rig import Rectification

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StereoSequence(Recording):
    """A `Dataset` of pairs; what follows sees them rectified.

    Attributes:
        name: Short name, used for the results folder.
        camera: The rectified left camera; its `bf` is that of the pair.
        camera_source: One line that says where the calibration comes from.
        timestamps_s: Times of the pairs (N,) float64 [s].
        left_files, right_files: The images.
        rectification: What rectifies them; None where they are rectified on disk.
        groundtruth: Poses of the rectified left camera, where there are any.
        unpaired_s: Times (M,) [s] of left images that were left out because no right one belongs to them.
        groundtruth_flaw: Why the ground truth that lies with the images cannot be used; empty where it can.
    """

    name: str
    camera: Camera
    camera_source: str
    timestamps_s: F64
    left_files: tuple[Path, ...]
    right_files: tuple[Path, ...]
    rectification: Rectification | None = None
    groundtruth: Trajectory | None = None
    unpaired_s: F64 = field(default_factory=lambda: np.zeros(0))
    groundtruth_flaw: str = ""
    sensor: Sensor = Sensor.STEREO

    def load(self, index: int) -> StereoImage:
        """Read pair `index`, and rectify it.

        Raises:
            IndexError: There is no such pair.
            FrameError: A file is missing, does not decode, or has another size than the sequence.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: no image {index}; there are {len(self)}, from 0")
        left_file, right_file = self.left_files[index], self.right_files[index]
        rgb, right = read_rgb(left_file), read_gray(right_file)
        if rgb.shape[:2] != right.shape:
            raise FrameError(
                f"{right_file}: {size_words(right)} pixels, the left image {size_words(rgb)}; both of a pair must be "
                "of one size"
            )
        if right.shape != (self.camera.height, self.camera.width):
            raise FrameError(
                f"{left_file}: {size_words(rgb)} pixels; the sequence has {camera_size_words(self.camera)}"
            )
        if self.rectification is not None:
            rgb, right = self.rectification.left(rgb), self.rectification.right(right)
        return StereoImage(float(self.timestamps_s[index]), rgb, right, index, left_file.stem)

    def checked(self, folder: Path) -> "StereoSequence":
        """Return itself after looking at its first pairs, and warning about gaps and left images without a right one.

        Raises:
            DatasetError: None of them can be used.
            CalibrationError: They are of another size than the camera's.
        """
        require_size(self.left_files, self.camera, self.camera_source)
        require_usable(folder, self)
        if len(self.unpaired_s):
            log.warning(
                "%s: %d of %d left images have no right image of the same moment and are left out; the coverage counts "
                "them as not tracked [see troubleshooting: unpaired-images]",
                self.name,
                len(self.unpaired_s),
                len(self.unpaired_s) + len(self),
            )
        remark_gaps(self.name, self.timestamps_s)
        return self
