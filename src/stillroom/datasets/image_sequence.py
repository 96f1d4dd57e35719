"""A sequence of image files: colour and depth paired in time, read when asked for."""

import logging
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.datasets.camera_file import choose_camera, choose_range
from stillroom.datasets.listing import Listing
from stillroom.datasets.pairing import Pairing, pair_images
from stillroom.datasets.recording import Recording
from stillroom.datasets.time_units import NAMES, groundtruth_in_seconds
from stillroom.errors import CalibrationError, DatasetError, FrameError, TrajectoryError
from stillroom.geometry.arrays import F32, F64, I64, U8, U16
from stillroom.geometry.camera import Camera

# EXIF says how the camera was held; the calibration is of the unrotated sensor.
COLOUR_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
GRAY_FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
PNG_START, PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
log = logging.getLogger(__name__)
GROUNDTRUTH_NAME = "groundtruth.txt"
NO_DEPTH = 65535
MOST_PIXELS = 100_000_000
JPEG_NO_FRAMES = frozenset((0xC4, 0xC8, 0xCC))
"""Markers among those of JPEG's frame headers that begin tables."""
PROBED_FRAMES = 5
LONG_GAP_S = 1.0


# Pixels from disk: the only place that knows OpenCV's blue-green-red order and a depth image's integers.


def read_rgb(path: Path) -> U8:
    """Read a colour image (H, W, 3) uint8, RGB order.

    Raises:
        FrameError: The file is missing, cut off, or no image.
    """
    bgr = _decode(path, COLOUR_FLAGS)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_gray(path: Path) -> U8:
    """Read the brightness (H, W) uint8 of an image.

    Raises:
        FrameError: The file is missing, cut off, or no image.
    """
    return np.asarray(_decode(path, GRAY_FLAGS), dtype=np.uint8)


def read_depth_units(path: Path) -> U16:
    """Read a depth image (H, W) uint16 in the sensor's units; 0 where unknown.

    Raises:
        FrameError: The file is missing, cut off, no image, or not one channel of 16 bits.
    """
    units = _decode(path, cv2.IMREAD_UNCHANGED)
    if units.ndim != 2 or units.dtype != np.uint16:
        channels = 1 if units.ndim == 2 else units.shape[2]
        raise FrameError(
            f"{path}: {channels} channel(s) of {units.dtype.itemsize * 8} bits; depth must be one channel of 16 bits"
        )
    return units.astype(np.uint16, copy=False)


def depth_in_metres(units: U16, depth_factor: float) -> F32:
    """Return depth (H, W) float32 [m] of sensor units with `depth_factor` units per metre."""
    return np.divide(units, np.float32(depth_factor), dtype=np.float32)


def without_unknown(units: U16, depth_factor: float, range_m: float) -> U16:
    """Return depth (H, W) uint16 in sensor units with 0 in place of what is no depth.

    That is 65535, which recorders write for "no depth" where 0 is not their word for it, and what lies beyond the
    sensor's range [m].
    """
    is_unknown = units == NO_DEPTH
    if np.isfinite(range_m):
        is_unknown |= units > range_m * depth_factor
    return np.where(is_unknown, np.uint16(0), units) if is_unknown.any() else units


def _decode(path: Path, flags: int) -> U8 | U16:
    try:
        encoded = path.read_bytes()
    except FileNotFoundError:
        raise FrameError(f"{path}: no such image, though the sequence lists it") from None
    except OSError as error:
        raise FrameError(f"{path}: cannot be read ({error.strerror})") from error
    n_pixels = _declared_pixels(encoded)
    if n_pixels > MOST_PIXELS:
        raise FrameError(f"{path}: does not decode as an image of a camera (its header names {n_pixels} pixels)")
    if _is_cut_off(encoded):
        raise FrameError(f"{path}: the image is cut off after {len(encoded)} bytes; fetch the sequence again")
    try:
        pixels = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), flags) if encoded else None
    except cv2.error as error:
        raise FrameError(f"{path}: does not decode as an image ({error.err})") from error
    if pixels is None:
        raise FrameError(f"{path}: does not decode as an image ({len(encoded)} bytes)")
    return pixels  # type: ignore[return-value]  # OpenCV types it as any integer or float array


def _declared_pixels(encoded: bytes) -> int:
    """Return how many pixels the header of a PNG or JPEG names; 0 for other formats. Room is made for all of them."""
    if encoded.startswith(PNG_START):
        width, height = int.from_bytes(encoded[16:20], "big"), int.from_bytes(encoded[20:24], "big")
        return width * height
    at = 2
    while encoded.startswith(JPEG_START) and at + 9 <= len(encoded) and encoded[at] == 0xFF:
        marker, length = encoded[at + 1], int.from_bytes(encoded[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in JPEG_NO_FRAMES:
            height, width = (int.from_bytes(encoded[at + k : at + k + 2], "big") for k in (5, 7))
            return width * height
        at += 2 + length
    return 0


def _has_whole_chunks(encoded: bytes) -> bool:
    """Return whether a PNG's chunks are as long as they say, which is what decoders make room for."""
    at = 8
    while at + 12 <= len(encoded) and encoded[at + 4 : at + 8] != b"IEND":
        at += 12 + int.from_bytes(encoded[at : at + 4], "big")
    return at + 12 <= len(encoded)


def _is_cut_off(encoded: bytes) -> bool:
    """Return whether a PNG or JPEG lacks its end.

    Some decoders fill what is missing with gray and report no error. Phones append data after a
    JPEG's end mark, and thumbnails at its start have end marks of their own, so the second half is searched; the
    coded pixels themselves cannot contain it.
    """
    if encoded.startswith(PNG_START):
        return PNG_END not in encoded[-64:] or not _has_whole_chunks(encoded)
    return encoded.startswith(JPEG_START) and JPEG_END not in encoded[len(encoded) // 2 :]


@dataclass(frozen=True)
class ImageSequence(Recording):
    """A `Dataset` whose images lie on disk.

    Attributes:
        name: Short name, used for the results folder.
        camera: The calibration in force.
        camera_source: One line that says where it comes from.
        timestamps_s: Times of the colour images (N,) float64 [s].
        rgb_files, depth_files: The images.
        groundtruth: Poses as the data set gives them, where it has any.
        groundtruth_at_camera: The same moved to the camera, where they are those of another body that rides on it.
        unpaired_s: Times (M,) [s] of colour images that were left out because no depth image belongs to them.
        range_m: Depth beyond this is none [m].
        groundtruth_flaw: Why `groundtruth.txt` cannot be used; empty where it can, or where there is none.
    """

    name: str
    camera: Camera
    camera_source: str
    timestamps_s: F64
    rgb_files: tuple[Path, ...]
    depth_files: tuple[Path, ...]
    groundtruth: Trajectory | None = None
    groundtruth_at_camera: Trajectory | None = None
    unpaired_s: F64 = field(default_factory=lambda: np.zeros(0))
    groundtruth_flaw: str = ""
    range_m: float = np.inf

    def load(self, index: int) -> RgbdImage:
        """Read image `index`.

        Raises:
            IndexError: There is no such image.
            FrameError: A file is missing, does not decode, or has another size or type than the sequence.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: no image {index}; there are {len(self)}, from 0")
        rgb, units = _read_pair(self.rgb_files[index], self.depth_files[index])
        expected = (self.camera.height, self.camera.width)
        if rgb.shape[:2] != expected:
            raise FrameError(
                f"{self.rgb_files[index]}: {size_words(rgb)} pixels; the sequence has {camera_size_words(self.camera)}"
            )
        units = without_unknown(units, self.camera.depth_factor, self.range_m)
        depth_m = depth_in_metres(units, self.camera.depth_factor)
        return RgbdImage(float(self.timestamps_s[index]), rgb, depth_m, index, self.rgb_files[index].stem)


def build_sequence(
    folder: Path,
    rgb: Listing,
    depth: Listing,
    camera: str | None = None,
    name: str | None = None,
    pairing: Pairing | None = None,
    pairs: tuple[I64, I64] | None = None,
) -> ImageSequence:
    """Pair the images, choose the calibration, read the ground truth, and look at the first frames.

    Args:
        folder: The sequence's folder; its `camera.toml` and `groundtruth.txt` are used where they exist.
        rgb: Colour images, at least one.
        depth: Depth images, at least one.
        camera: The calibration that the user asks for, a name or a file.
        name: Name of the sequence; the folder's where not given.
        pairing: How images are paired.
        pairs: Indices (K,) into `rgb` and (K,) into `depth` of images that belong together; as `pairing` says where
            not given.

    Raises:
        DatasetError: Nothing pairs, or none of the first frames can be used.
        CalibrationError: No calibration is known, or its size is not that of the images.
    """
    name = name or folder.resolve().name
    calibration, source = choose_camera(folder, name, camera)
    of_rgb, of_depth = pairs or pair_images(folder, rgb, depth, pairing or Pairing())
    groundtruth, flaw = read_groundtruth(folder / GROUNDTRUTH_NAME, rgb.timestamps_s)
    sequence = ImageSequence(
        name=name,
        camera=calibration,
        camera_source=source,
        timestamps_s=rgb.timestamps_s[of_rgb],
        rgb_files=tuple(rgb.files[i] for i in of_rgb),
        depth_files=tuple(depth.files[i] for i in of_depth),
        groundtruth=groundtruth,
        unpaired_s=np.delete(rgb.timestamps_s, of_rgb),
        groundtruth_flaw=flaw,
        range_m=choose_range(folder, camera),
    )
    _probe(folder, sequence)
    _remark(sequence)
    return sequence


def read_groundtruth(path: Path, times_s: F64) -> tuple[Trajectory | None, str]:
    """Return the ground truth, where there is one that can be used, and what is wrong with one that cannot.

    Args:
        path: A file in TUM's format, which may be missing.
        times_s: Times (N,) [s] of the images, by which the unit of its times is told.
    """
    if not path.exists():
        return None, ""
    try:
        as_written = read_tum(path)
    except TrajectoryError as error:
        flaw = str(error).partition(" [see")[0]
        log.warning("ground truth is left out, so there are no figures: %s [see troubleshooting: groundtruth]", flaw)
        return None, flaw
    groundtruth, unit = groundtruth_in_seconds(as_written, times_s)
    if unit != "s":
        log.warning("%s: read as %s, converted to seconds [see troubleshooting: time-unit]", path, NAMES[unit])
    return groundtruth, ""


def _probe(folder: Path, sequence: ImageSequence) -> None:
    """Read the first usable frame; if none of them is usable, the sequence is not."""
    errors: list[FrameError] = []
    for rgb_file, depth_file in list(zip(sequence.rgb_files, sequence.depth_files, strict=True))[:PROBED_FRAMES]:
        try:
            rgb, units = _read_pair(rgb_file, depth_file)
        except FrameError as error:
            errors.append(error)
            continue
        if rgb.shape[:2] != (sequence.camera.height, sequence.camera.width):
            raise CalibrationError(
                f"{rgb_file}: {size_words(rgb)} pixels, but the camera ({sequence.camera_source}) has "
                f"{camera_size_words(sequence.camera)}; give the calibration of this sequence"
            )
        if (units == NO_DEPTH).any():
            log.warning(
                "%s: depth of %d, which no sensor measures, is read as unknown here and in all images "
                "[see troubleshooting: depth-range]",
                depth_file,
                NO_DEPTH,
            )
        return
    raise DatasetError(f"{folder}: none of the first {len(errors)} frames can be used; {errors[0]}")


def _remark(sequence: ImageSequence) -> None:
    """Warn about gaps and unpaired images of a usable sequence."""
    n_unpaired = len(sequence.unpaired_s)
    if n_unpaired:
        log.warning(
            "%s: %d of %d colour images have no depth image that belongs to them and are left out; the coverage counts "
            "them as not tracked [see troubleshooting: unpaired-images]",
            sequence.name,
            n_unpaired,
            n_unpaired + len(sequence),
        )
    remark_gaps(sequence.name, sequence.timestamps_s)


def remark_gaps(name: str, timestamps_s: F64) -> None:
    """Warn about gaps between the times (N,) [s] of a sequence's images."""
    steps_s = np.diff(timestamps_s)
    if len(steps_s) == 0:
        return
    # A sequence recorded slowly on purpose needs no warning.
    limit_s = max(LONG_GAP_S, 5.0 * float(np.median(steps_s)))
    long = np.flatnonzero(steps_s > limit_s)
    if len(long):
        worst = int(long[np.argmax(steps_s[long])])
        log.warning(
            "%s: %d gap(s) in time, the longest %.1f s before image %d; tracking may be lost there",
            name,
            len(long),
            steps_s[worst],
            worst + 1,
        )


def _read_pair(rgb_file: Path, depth_file: Path) -> tuple[U8, U16]:
    rgb, units = read_rgb(rgb_file), read_depth_units(depth_file)
    if rgb.shape[:2] != units.shape:
        raise FrameError(
            f"{depth_file}: depth of {size_words(units)} pixels, colour of {size_words(rgb)}; depth must be registered "
            "to colour"
        )
    return rgb, units


def size_words(pixels: U8 | U16) -> str:
    """Return the size of an image as width×height."""
    return f"{pixels.shape[1]}×{pixels.shape[0]}"


def camera_size_words(camera: Camera) -> str:
    """Return the size of a camera's images as width×height."""
    return f"{camera.width}×{camera.height}"
