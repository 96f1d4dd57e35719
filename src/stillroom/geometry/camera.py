"""The pinhole camera with Brown–Conrady distortion and registered depth."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np

from stillroom.compiled import njit
from stillroom.errors import CalibrationError
from stillroom.geometry.arrays import F32, F64, Floats
from stillroom.geometry.depth_noise import KNOWN, UNKNOWN
from stillroom.geometry.pixels import in_pixels, pixel_scale

Coordinate = TypeVar("Coordinate", float, F64)


class Lens(NamedTuple):
    """What kernels know of a camera; numba reads a named tuple as it is.

    Attributes:
        fx, fy, cx, cy: Intrinsics [px].
        k1, k2, p1, p2, k3: Brown–Conrady distortion, OpenCV's order.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


def brown_conrady(lens: Lens, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
    """Return where in the image as taken a camera sees the ray (x, y, 1), or many, [px]; kernels: `distorted`."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    u = lens.fx * (x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (r2 + 2.0 * x * x)) + lens.cx
    v = lens.fy * (y * radial + lens.p1 * (r2 + 2.0 * y * y) + 2.0 * lens.p2 * x * y) + lens.cy
    return u, v


_ITERATIONS, _NEAR_PX = 20, 1e-6


@njit(nogil=True, cache=True)
def undistorted(raw_px: F64, lens: Lens) -> F32:
    """Return where an ideal pinhole would see points (N, 2) of the image as taken, (N, 2) [px].

    Fixed-point iterations, until what is found is seen within a millionth of a pixel of the point: those of OpenCV's
    `undistortPointsIter` (`undistortPoints` in OpenCV 5), which costs two to three times as much.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    ideal_px = np.empty((len(raw_px), 2), np.float32)
    per_fx, per_fy = 1.0 / fx, 1.0 / fy
    for i in range(len(raw_px)):
        u, v = raw_px[i, 0], raw_px[i, 1]
        x0, y0 = (u - cx) * per_fx, (v - cy) * per_fy
        x, y = x0, y0
        for _ in range(_ITERATIONS):
            r2 = x * x + y * y
            per_radial = 1.0 / (1.0 + ((k3 * r2 + k2) * r2 + k1) * r2)
            if per_radial < 0.0:  # beyond where the lens can see
                x, y = x0, y0
                break
            dx, dy = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
            x, y = (x0 - dx) * per_radial, (y0 - dy) * per_radial
            r2 = x * x + y * y
            radial = 1.0 + k1 * r2 + k2 * (r2 * r2) + k3 * (r2 * r2 * r2)
            e_u = (x * radial + p1 * (2.0 * x * y) + p2 * (r2 + 2.0 * x * x)) * fx + cx - u
            e_v = (y * radial + p1 * (r2 + 2.0 * y * y) + p2 * (2.0 * x * y)) * fy + cy - v
            if math.sqrt(e_u * e_u + e_v * e_v) < _NEAR_PX:
                break
        ideal_px[i, 0], ideal_px[i, 1] = fx * x + cx, fy * y + cy
    return ideal_px


LONGEST_READOUT_S = 0.2


_POSITIVE = "depth_factor", "bf", "depth_scale"


@dataclass(frozen=True)
class Camera:
    """An RGB-D camera: x right, y down, z forward; pixel centres at integers; depth registered to colour.

    Attributes:
        width, height: Image size [px].
        fx, fy, cx, cy: Intrinsics [px].
        distortion: k1 k2 p1 p2 k3, OpenCV's order.
        depth_factor: Units of the 16-bit depth image per metre.
        bf: Baseline of the virtual stereo pair times fx [px·m]: a depth d has the right coordinate u − bf/d
            (40 for Kinect-like sensors; docs/reference.md#orb-slam2-camera-and-features).
        readout_s: Time from the first row of a colour image to the last [s]: a rolling shutter; 0 for a global one.
            An image's time is that of its middle row.
        depth_noise: What measures depth, which tells how well: structured-light, time-of-flight, or unknown
            (`geometry.depth_noise`).
        depth_scale: By what depth as stored is multiplied; below 1 where the sensor reads too far.
        depth_offset_s: What has to be added to the time of a depth image [s]; negative where it is stamped late. At 0
            depth counts as taken with its colour image, else `RgbdImage.depth_after_s` says when it was.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    depth_factor: float = 5000.0
    bf: float = 40.0
    readout_s: float = 0.0
    depth_noise: str = UNKNOWN
    depth_scale: float = 1.0
    depth_offset_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a camera that cannot exist.

        Raises:
            CalibrationError: A number is not finite, or a size, focal length, factor or baseline is not positive.
        """
        numbers = {name: getattr(self, name) for name in ("fx", "fy", "cx", "cy", *_POSITIVE)}
        for name, value in numbers.items():
            if not np.isfinite(value):
                raise CalibrationError(f"camera: {name} is {value}; it must be a finite number")
        for name in ("width", "height", "fx", "fy", *_POSITIVE):
            if getattr(self, name) <= 0:
                raise CalibrationError(f"camera: {name} is {getattr(self, name)}; it must be positive")
        if not 0.0 <= self.readout_s <= LONGEST_READOUT_S:
            raise CalibrationError(
                f"camera: readout_s is {self.readout_s}; it must be 0 to {LONGEST_READOUT_S} s, the time in which the "
                "rows of an image are read"
            )
        if self.depth_noise not in KNOWN:
            raise CalibrationError(f"camera: depth_noise is '{self.depth_noise}'; it must be one of {', '.join(KNOWN)}")
        if not np.isfinite(self.depth_offset_s):
            raise CalibrationError(f"camera: depth_offset_s is {self.depth_offset_s}; it must be a number of seconds")
        if len(self.distortion) != 5 or not np.all(np.isfinite(self.distortion)):
            raise CalibrationError(f"camera: distortion is {self.distortion}; it must be five numbers k1 k2 p1 p2 k3")

    @cached_property
    def lens(self) -> Lens:
        """Intrinsics and distortion, as kernels take them."""
        return Lens(*(float(value) for value in (self.fx, self.fy, self.cx, self.cy, *self.distortion)))

    @cached_property
    def K(self) -> F64:
        """Intrinsic matrix (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def units_per_m(self) -> float:
        """Units of the depth image per true metre."""
        return self.depth_factor if self.depth_scale == 1.0 else self.depth_factor / self.depth_scale

    @property
    def baseline_m(self) -> float:
        """Baseline of the virtual stereo pair [m]."""
        return self.bf / self.fx

    @property
    def pixel_scale(self) -> float:
        """By what lengths in pixels, which are those of images 640 pixels long, are multiplied in this one's images."""
        return pixel_scale(self.width, self.height)

    def in_pixels(self, length_px: int) -> int:
        """Return a whole length of images 640 pixels long in this one's images [px]; at least 1, but 0 stays 0."""
        return in_pixels(length_px, self.pixel_scale)

    def rows_after_s(self, raw_y_px: Floats) -> F64:
        """Return when rows (N,) of the image as taken are read, from its middle on (N,) [s]."""
        return ((np.asarray(raw_y_px, dtype=np.float64) + 0.5) / self.height - 0.5) * self.readout_s

    @property
    def is_distorted(self) -> bool:
        """Whether any distortion coefficient differs from zero."""
        return any(self.distortion)

    def undistort(self, raw_px: Floats) -> F32:
        """Move points (N, 2) of the image as taken to where an ideal pinhole would see them, (N, 2)."""
        if len(raw_px) == 0 or not self.is_distorted:
            return np.ascontiguousarray(raw_px, dtype=np.float32)
        return np.asarray(undistorted(np.ascontiguousarray(raw_px, dtype=np.float64), self.lens), dtype=np.float32)

    def distort(self, px: Floats) -> F64:
        """Move undistorted points (N, 2) to where they lie in the image as taken, (N, 2) [px]."""
        x, y = ((np.asarray(px, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)).T
        return np.stack(brown_conrady(self.lens, x, y), axis=1)

    @cached_property
    def undistorted_bounds_px(self) -> tuple[float, float, float, float]:
        """The undistorted image's extent (x_min, y_min, x_max, y_max) [px], from its four corners."""
        w, h = self.width - 1.0, self.height - 1.0
        corners = self.undistort(np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float32))
        return (
            float(min(corners[0, 0], corners[2, 0])),
            float(min(corners[0, 1], corners[1, 1])),
            float(max(corners[1, 0], corners[3, 0])),
            float(max(corners[2, 1], corners[3, 1])),
        )

    def project(self, points_cam_m: Floats) -> F64:
        """Project points (N, 3) of the camera frame with z > 0 to undistorted pixels (N, 2)."""
        z = points_cam_m[:, 2]
        return np.stack(
            (self.fx * points_cam_m[:, 0] / z + self.cx, self.fy * points_cam_m[:, 1] / z + self.cy), axis=1
        )

    def back_project(self, undistorted_px: Floats, depth_m: Floats) -> F64:
        """Return the points (N, 3) of the camera frame at pixels (N, 2) with depths (N,) [m]."""
        z = np.asarray(depth_m, dtype=np.float64)
        x = (undistorted_px[:, 0].astype(np.float64) - self.cx) / self.fx * z
        y = (undistorted_px[:, 1].astype(np.float64) - self.cy) / self.fy * z
        return np.stack((x, y, z), axis=1)

    def right_coordinate(self, x_px: Floats, depth_m: Floats) -> F32:
        """Return u − bf/d (N,) [px] of the virtual right image; −1 where the depth (N,) is unknown."""
        known = depth_m > 0
        safe_m = np.where(known, depth_m, 1.0)
        return np.where(known, x_px - self.bf / safe_m, -1.0).astype(np.float32)
