"""Can this calibration be true? What is impossible is refused; what is doubtful is one warning with its likely cause.

A wrong calibration does not stop a SLAM system: it bends or scales the map, and every frame counts as tracked.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stillroom.errors import CalibrationError
from stillroom.evaluation.report import Evaluation
from stillroom.geometry.arrays import F32, F64
from stillroom.geometry.camera import Camera
from stillroom.tracking.readout_check import RowsFound

POSSIBLE_FOV_DEG = 5.0, 175.0
USUAL_FOV_DEG = 20.0, 120.0
"""Horizontal fields of view [deg] that a pinhole model can have, and that cameras of this kind have."""
CENTRED = 0.15
"""By what part of the image's size principal points are off its centre at most, usually."""
SQUARE = 1.2
"""Largest usual ratio of fx and fy."""
FOLD_PX = 1.0
"""How near undistorting and distorting must come to where they began, in images 640 pixels long [px]."""
MOST_FOLDED = 0.05
"""Share of the image that may be folded, in its corners, by a distortion that was fitted with too few terms."""
LEAST_NEAR_M, LEAST_FAR_M, MOST_FAR_M = 0.2, 0.9, 10.0
"""Percentiles 1 and 99 of depths that are usual: RGB-D cameras measure nothing nearer and little that is farther, and
in a room they see more than what is within reach."""
LEAST_SIDE_PX = 320
"""Longer side of the smallest images in which trajectories are as exact as in those 640 pixels long."""
USUAL_STEP_S = 0.002, 0.5
"""Time between images that the memories of sieves, which compare with images 0.2 to 10 s old, can work with."""
N_STEPS = 8
N_DEPTHS = 5
"""Images whose depths are looked at."""
DEPTH_STEP_PX = 7
SCALE = 1.2
"""Scale of a trajectory against the truth that is doubtful, or its inverse."""
EXPLAINED = 0.5
"""Share of the error that must be left after scaling at most, or something else than scale is wrong."""
MOVED_M = 0.05
"""The truth must have moved by this much (RMS about its mean) to say anything about scale or about standing still."""


@dataclass(frozen=True)
class Doubt:
    """Something that is probably wrong.

    Attributes:
        name: Its row in docs/troubleshooting.md.
        text: One line: what is odd, and the likely cause.
    """

    name: str
    text: str

    def __str__(self) -> str:
        """Return the line, with the name of the row."""
        return f"{self.text} [see troubleshooting: {self.name}]"


def require_possible(camera: Camera) -> None:
    """Refuse a calibration that no camera can have.

    Raises:
        CalibrationError: The intrinsics are those of a normalised image, the principal point is outside of the image,
            the field of view cannot be, or the distortion folds inside the image.
    """
    if camera.fx < 10.0 and camera.width > 100:
        raise CalibrationError(
            f"camera: fx is {camera.fx:g} in an image of {camera.width} pixels; these look like normalised intrinsics: "
            "multiply fx and cx by the width, fy and cy by the height [see troubleshooting: intrinsics]"
        )
    for name, value, size in (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)):
        if not 0.0 < value < size - 1.0:
            raise CalibrationError(
                f"camera: {name} is {value:g}, outside of an image of {size} pixels; is the calibration of another "
                "resolution? [see troubleshooting: intrinsics]"
            )
    if not POSSIBLE_FOV_DEG[0] < _fov_deg(camera) < POSSIBLE_FOV_DEG[1]:
        raise CalibrationError(
            f"camera: fx {camera.fx:g} in an image of {camera.width} pixels is a field of view of "
            f"{_fov_deg(camera):.1f} degrees; is the calibration of another resolution? "
            "[see troubleshooting: intrinsics]"
        )
    folded = _folded(camera)
    if folded > MOST_FOLDED:
        raise CalibrationError(f"camera: {_fold_text(camera, folded)} [see troubleshooting: distortion]")


def doubts_of_camera(camera: Camera) -> Iterator[Doubt]:
    """Yield what is odd about a possible calibration."""
    off_x, off_y = camera.cx / camera.width - 0.5, camera.cy / camera.height - 0.5
    if max(abs(off_x), abs(off_y)) > CENTRED:
        swapped = max(abs(camera.cy / camera.width - 0.5), abs(camera.cx / camera.height - 0.5)) < 0.5 * CENTRED
        cause = "are cx and cy swapped" if swapped else "is the calibration of another resolution, or a crop"
        yield Doubt(
            "intrinsics",
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the centre of an image of "
            f"{camera.width}×{camera.height}; {cause}?",
        )
    elif not USUAL_FOV_DEG[0] < _fov_deg(camera) < USUAL_FOV_DEG[1]:
        yield Doubt(
            "intrinsics",
            f"fx {camera.fx:g} in an image of {camera.width} pixels is a field of view of {_fov_deg(camera):.0f} "
            "degrees; is the calibration of another resolution?",
        )
    if not 1.0 / SQUARE < camera.fx / camera.fy < SQUARE:
        yield Doubt("intrinsics", f"fx {camera.fx:g} and fy {camera.fy:g} differ by more than {SQUARE - 1:.0%}")
    if max(camera.width, camera.height) < LEAST_SIDE_PX:
        yield Doubt(
            "image-size",
            f"images of {camera.width}×{camera.height} show few details to track: poses are less exact than "
            "from larger ones; record such if you can",
        )
    if (folded := _folded(camera)) > 0.0:
        yield Doubt("distortion", _fold_text(camera, folded))


class DepthRange:
    """Looks at the depths of the first images, and says once whether they can be metres."""

    def __init__(self, depth_factor: float) -> None:
        """Name the factor that the depths were made with."""
        self._depth_factor, self._samples_m = depth_factor, list[F32]()
        self._is_done = False

    def add(self, depth_m: F32) -> Iterator[Doubt]:
        """Look at a depth image (H, W) [m]; yield a doubt when enough are seen."""
        if self._is_done:
            return
        self._samples_m.append(depth_m[::DEPTH_STEP_PX, ::DEPTH_STEP_PX])
        if len(self._samples_m) < N_DEPTHS:
            return
        seen_m = np.concatenate([sample[sample > 0] for sample in self._samples_m])
        self._is_done, self._samples_m = True, []
        if len(seen_m) == 0:
            yield Doubt("no-depth", f"the first {N_DEPTHS} images have no depth anywhere; is it registered and saved?")
            return
        near_m, far_m = (float(value) for value in np.percentile(seen_m, (1.0, 99.0)))
        is_small = near_m < LEAST_NEAR_M or far_m < LEAST_FAR_M
        if is_small or far_m > MOST_FAR_M:
            size = "large" if is_small else "small"
            yield Doubt(
                "depth-factor",
                f"depths go from {near_m:.2f} to {far_m:.2f} m, unusual for an RGB-D camera in a room; the depth "
                f"factor, {self._depth_factor:g} units per metre, may be too {size} (TUM's and Bonn's files have 5000, "
                "files in millimetres 1000)",
            )


class ImageTimes:
    """Looks at the times of the first images, and says once whether they can be seconds."""

    def __init__(self) -> None:
        """Start before the first image."""
        self._times_s: list[float] = []

    def add(self, timestamp_s: float) -> Iterator[Doubt]:
        """Look at the time of an image [s]; yield a doubt when enough are seen."""
        if len(self._times_s) > N_STEPS:
            return
        self._times_s.append(timestamp_s)
        if len(self._times_s) <= N_STEPS:
            return
        step_s = float(np.median(np.diff(self._times_s)))
        if not USUAL_STEP_S[0] <= step_s <= USUAL_STEP_S[1]:
            yield Doubt(
                "image-times",
                f"images come every {step_s:g} s, and the memories of sieves, which ask for images 0.2 to 10 s old, "
                "find none of the age they want; are the times in seconds?",
            )


class ShutterDoubts:
    """Says once each that rows are read as one, and that the readout of a recording is another than the camera's."""

    def __init__(self) -> None:
        """Start with nothing said."""
        self._has_said_as_one, self._has_said_other = False, False

    def add(self, rows: RowsFound | None) -> Iterator[Doubt]:
        """Look at what the recording says of the camera's readout so far; None where nothing is known."""
        if rows is None:
            return
        found = f"{1e3 * rows.readout_s:.0f} ± {1e3 * rows.sigma_s:.0f} ms"
        looks = f"this recording's readout looks like {found}, its camera file says {1e3 * rows.file_s:.3g} ms"
        if rows.as_one and not self._has_said_as_one:
            self._has_said_as_one = True
            yield Doubt(
                "shutter", f"{looks}: rows are read as one; if the shutter is a global one, leave out readout_s"
            )
        elif rows.is_other and not rows.as_one and not self._has_said_other:
            self._has_said_other = True
            yield Doubt("shutter", f"{looks}; 'stillroom calibrate shutter' estimates it")


def doubts_of_figures(evaluation: Evaluation) -> Iterator[Doubt]:
    """Yield what is odd about a trajectory that was compared with the truth."""
    found = evaluation.as_given
    if found.still_camera_m < MOVED_M:
        return
    explained = found.ate_sim3_m.rmse < EXPLAINED * found.ate_m.rmse  # never, of what is up to scale
    if explained and not 1.0 / SCALE < found.scale < SCALE:
        yield Doubt(
            "scale",
            f"the trajectory fits the ground truth best when it is scaled by {found.scale:.2f}; the depth factor or "
            "the focal length is probably wrong",
        )
    if found.ate_m.rmse > found.still_camera_m:
        yield Doubt(
            "worse-than-static",
            f"ATE {found.ate_m.rmse:.3f} m is worse than that of a camera that never moves "
            f"({found.still_camera_m:.3f} m); check calibration, depth factor, the times of images and truth, and "
            "whether what moves was taken for static",
        )


def _fov_deg(camera: Camera) -> float:
    return math.degrees(2.0 * math.atan(camera.width / (2.0 * camera.fx)))


def _folded(camera: Camera) -> float:
    """Return which share of the image, 0 to 1, no ray is seen at: undistorted and distorted again, it is elsewhere."""
    if not camera.is_distorted:
        return 0.0
    x, y = np.meshgrid(np.linspace(0.0, camera.width - 1.0, 41), np.linspace(0.0, camera.height - 1.0, 31))
    px: F64 = np.column_stack((x.ravel(), y.ravel()))
    off_px = np.abs(camera.distort(camera.undistort(px)) - px).max(axis=1)
    return float(np.mean(~(off_px < FOLD_PX * camera.pixel_scale)))


def _fold_text(camera: Camera, folded: float) -> str:
    return (
        f"the distortion {camera.distortion} folds inside the image: {folded:.1%} of its pixels, undistorted and "
        "distorted again, come out elsewhere; are its order (k1 k2 p1 p2 k3) and signs right?"
    )
