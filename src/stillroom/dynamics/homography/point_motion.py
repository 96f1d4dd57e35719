"""The motion test of one point: is it where a static one would be?"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.dynamics.homography.patches import NO_CORNER, NOT_SEEN, ROOM, find_patch
from stillroom.geometry.arrays import F32, F64, I64, U8, Bool
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import distorted

UNKNOWN, STATIC, DYNAMIC = 0, 1, 2
"""Results of the test."""
FOUND, ABSENT = 1, 2
"""Results of the patch search; UNKNOWN is as above."""
DEPTH_STEP_PX = 2
"""Spacing of the nine pixels of the depth image that are compared, in images 640 pixels long."""
SHRINK = 2
"""How many times smaller the finer images are in which patches are searched, in images 640 pixels long."""
_NEAR_M = 0.1


@dataclass(frozen=True)
class PointTestConfig:
    """When a point moves.

    Attributes:
        use_depth: Whether depth and the pose may explain what the homography cannot: parallax. If not, the homography
            alone decides (the paper's rule), which holds for a plane, a far scene, or a pure rotation.
        threshold_px: Largest distance of a static point from where it should be in the earlier image [px].
        tolerance_m, tolerance_share: Two depths agree when they differ by less than the larger of the first and this
            share of the depth.
        min_likeness: Normalised correlation from which on a patch counts as found.
        max_unlikeness: Where depth says that the place was in view, a patch whose correlation stays below this is not
            there, wherever it may have been.
        nearest_m: Smallest depth assumed for a point without one, which bounds its parallax [m].
        iterations: Steps of the search for a patch.
    """

    use_depth: bool = True
    threshold_px: float = bounded(2.5, least=0, pixels=1)
    tolerance_m: float = 0.08
    tolerance_share: float = 0.04
    min_likeness: float = 0.8
    max_unlikeness: float = 0.6
    nearest_m: float = 0.5
    iterations: int = 8


@dataclass(frozen=True)
class ImageView:
    """An image as the test reads it.

    Attributes:
        half, quarter: Brightness at half and a quarter of the size, (H/2, W/2) and (H/4, W/4), distorted; of images
            640 pixels long: larger ones are shrunk more, to the same sizes.
        depth_m: Depth (H, W) [m], 0 where unknown.
    """

    half: U8 = field(repr=False)
    quarter: U8 = field(repr=False)
    depth_m: F32 = field(repr=False)


class _Images(NamedTuple):
    """Both images of a test, see `ImageView`; `times` is how many times smaller the halves are."""

    now_half: U8
    now_quarter: U8
    then_half: U8
    then_quarter: U8
    then_depth_m: F32
    times: int


class _TestPoints(NamedTuple):
    """The points of a test, as taken and undistorted (N, 2) [px], and their depths (N,) [m]."""

    raw_px: F64
    px: F64
    depth_m: F64


class _Motions(NamedTuple):
    """How the camera moved: in space, and as a homography."""

    T_then_now: F64
    H_then_now: F64


class _Limits(NamedTuple):
    """`PointTestConfig` as the kernels take it."""

    use_depth: bool
    threshold_px: float
    tolerance_m: float
    tolerance_share: float
    min_likeness: float
    max_unlikeness: float
    nearest_m: float
    iterations: int
    depth_step_px: int


class _Answers(NamedTuple):
    """Where verdicts (K,) and residuals (K, 2) [px] are written."""

    verdicts: I64
    residual_px: F64


@dataclass(frozen=True)
class PointTest:
    """A test of the keypoints of the present image against an earlier one; call it with those to be tested.

    Attributes:
        config: Thresholds.
        camera: Of both images.
        now, then: Present and earlier image.
        raw_px, px, depth_m: The points (N, 2) as taken, (N, 2) undistorted [px], and their depths (N,) [m].
        T_then_now: Motion of the camera (4, 4).
        H_then_now: The compensated homography, present to earlier (3, 3).
    """

    config: PointTestConfig
    camera: Camera
    now: ImageView
    then: ImageView
    raw_px: F64
    px: F64
    depth_m: F64
    T_then_now: F64
    H_then_now: F64

    def __call__(self, which: I64) -> I64:
        """Return UNKNOWN, STATIC or DYNAMIC for each of the points `which` (K,)."""
        verdicts = np.empty(len(which), dtype=np.int64)
        self._run(which, verdicts, np.empty((len(which), 2)))
        return verdicts

    def residuals_px(self, which: I64) -> F64:
        """Return how far each of the points `which` (K,) is from its prediction by pose and by homography, (K, 2) [px].

        The first is NaN where there is no depth, both where the point was not found in the earlier image.
        """
        residual_px = np.empty((len(which), 2))
        self._run(which, np.empty(len(which), dtype=np.int64), residual_px)
        return residual_px

    def is_dynamic(self, which: I64) -> Bool:
        """Return which of the points `which` (K,) move."""
        moves: Bool = self(which) == DYNAMIC
        return moves

    def _run(self, which: I64, verdicts: I64, residual_px: F64) -> None:
        judge_points(which, *self._given, _Answers(verdicts, residual_px))

    @cached_property
    def _given(self) -> tuple[_Images, _TestPoints, _Motions, Lens, _Limits]:
        """The constant arguments of the kernel."""
        c = self.config
        return (
            _Images(
                self.now.half,
                self.now.quarter,
                self.then.half,
                self.then.quarter,
                self.then.depth_m,
                self.camera.in_pixels(SHRINK),
            ),
            _TestPoints(self.raw_px, self.px, self.depth_m),
            _Motions(self.T_then_now, self.H_then_now),
            self.camera.lens,
            _Limits(
                c.use_depth,
                float(c.threshold_px),
                float(c.tolerance_m),
                float(c.tolerance_share),
                float(c.min_likeness),
                float(c.max_unlikeness),
                float(c.nearest_m),
                c.iterations,
                self.camera.in_pixels(DEPTH_STEP_PX),
            ),
        )


@njit(nogil=True, cache=True)
def ask_depth(depth_m: F32, px: F64, z: float, tolerance_m: float, edge: int) -> int:
    """Return what a depth image (H, W) shows at a pixel and at eight `edge` pixels off, for a surface to be z away.

    Returns:
        STATIC when one of nine pixels agrees, DYNAMIC when all known ones lie behind: the place was free; UNKNOWN else:
            it was occluded, or depth is unknown. −1 outside the image.
    """
    column, row = int(px[0] + 0.5), int(px[1] + 0.5)
    if not (edge <= row < depth_m.shape[0] - edge and edge <= column < depth_m.shape[1] - edge):
        return -1
    n_known, n_behind = 0, 0
    for dy in range(-edge, edge + 1, edge):
        for dx in range(-edge, edge + 1, edge):
            seen = depth_m[row + dy, column + dx]
            if seen <= 0.0:
                continue
            if abs(seen - z) <= tolerance_m:
                return STATIC
            n_known += 1
            n_behind += seen > z
    return DYNAMIC if n_known > 0 and n_known == n_behind else UNKNOWN


@njit(nogil=True, cache=True)
def locate(images: _Images, raw: F64, guess: F64, limits: _Limits, scratch: F32, found: F64) -> int:
    """Find a point of the present image (2,) in the earlier one, from a guess (2,) on; both as taken [px].

    Near the guess at half size first; where it is not there, farther away at a quarter of the size, then near that.

    Returns:
        FOUND; ABSENT when the patch at the guess does not match; UNKNOWN else, or where there is no corner.
    """
    now_half, now_quarter, then_half, then_quarter, _, times = images
    half, quarter = 1.0 / times, 0.5 / times
    # Pixel centres are at integers: those of a shrunk image lie between those of the whole one.
    to_half, to_quarter = 0.5 - 0.5 * half, 0.5 - 0.5 * quarter
    min_likeness, iterations = limits.min_likeness, limits.iterations
    x, y = half * raw[0] - to_half, half * raw[1] - to_half
    u, v = half * guess[0] - to_half, half * guess[1] - to_half
    near = find_patch(now_half, (x, y), then_half, (u, v), iterations, scratch, found)
    likeness = near
    if near == NO_CORNER:
        return UNKNOWN
    if near < min_likeness:
        u, v = quarter * guess[0] - to_quarter, quarter * guess[1] - to_quarter
        x4, y4 = quarter * raw[0] - to_quarter, quarter * raw[1] - to_quarter
        if find_patch(now_quarter, (x4, y4), then_quarter, (u, v), iterations, scratch, found) >= min_likeness:
            u, v = 2.0 * found[0] + 0.5, 2.0 * found[1] + 0.5
            likeness = find_patch(now_half, (x, y), then_half, (u, v), iterations, scratch, found)
    found[0], found[1] = times * found[0] + 0.5 * (times - 1), times * found[1] + 0.5 * (times - 1)
    if likeness >= min_likeness:
        return FOUND
    return ABSENT if NOT_SEEN < near < limits.max_unlikeness else UNKNOWN


@njit(nogil=True, cache=True)
def unexplained_px(found: F64, by_plane: F64, T_then_now: F64, lens: Lens, nearest_m: float) -> float:
    """Return the part of a point's distance (2,) from its prediction by the plane that no depth explains [px].

    A point off the plane is shifted along its epipolar line, by no more than one at `nearest_m` (plane and parallax).
    """
    rx, ry = found[0] - by_plane[0], found[1] - by_plane[1]
    t = T_then_now[:3, 3]
    # The direction to the epipole, which is where the camera stood: K t, at infinity when it moved sideways.
    ex = lens.fx * t[0] + (lens.cx - by_plane[0]) * t[2]
    ey = lens.fy * t[1] + (lens.cy - by_plane[1]) * t[2]
    norm = np.sqrt(ex * ex + ey * ey)
    if norm < 1e-6:
        return float(np.sqrt(rx * rx + ry * ry))
    along, across = (rx * ex + ry * ey) / norm, (rx * ey - ry * ex) / norm
    beyond = max(0.0, abs(along) - norm / nearest_m)
    return float(np.sqrt(across * across + beyond * beyond))


@njit(nogil=True, cache=True)
def judge_points(
    which: I64, images: _Images, points: _TestPoints, motions: _Motions, lens: Lens, limits: _Limits, answers: _Answers
) -> None:
    """Write the results for the points `which` (K,); see `PointTest`."""
    raw_px, px, depth_m = points
    T, H = motions
    verdicts, residual_px = answers
    then_depth_m, use_depth = images.then_depth_m, limits.use_depth
    scratch = np.zeros(ROOM, dtype=np.float32)
    by_pose, by_plane, found = np.empty(2), np.empty(2), np.empty(2)
    for k in range(len(which)):
        i = which[k]
        verdicts[k] = UNKNOWN
        residual_px[k, :] = np.nan
        x, y = px[i, 0], px[i, 1]
        w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
        hx, hy = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
        by_plane[0], by_plane[1] = distorted(lens, (hx - lens.cx) / lens.fx, (hy - lens.cy) / lens.fy)
        deep, shown = use_depth and depth_m[i] > 0.0, UNKNOWN
        if deep:
            rx, ry, z = (x - lens.cx) / lens.fx * depth_m[i], (y - lens.cy) / lens.fy * depth_m[i], depth_m[i]
            there = T[2, 0] * rx + T[2, 1] * ry + T[2, 2] * z + T[2, 3]
            if there < _NEAR_M:
                continue
            tx = (T[0, 0] * rx + T[0, 1] * ry + T[0, 2] * z + T[0, 3]) / there
            ty = (T[1, 0] * rx + T[1, 1] * ry + T[1, 2] * z + T[1, 3]) / there
            by_pose[0], by_pose[1] = distorted(lens, tx, ty)
            tolerance_m = max(limits.tolerance_m, limits.tolerance_share * there)
            shown = ask_depth(then_depth_m, by_pose, there, tolerance_m, limits.depth_step_px)
            if shown == UNKNOWN and then_depth_m[int(by_pose[1] + 0.5), int(by_pose[0] + 0.5)] > 0.0:
                continue  # It was occluded.
        guess = by_pose if deep else by_plane
        state = locate(images, raw_px[i], guess, limits, scratch, found)
        if state != FOUND:
            if shown == DYNAMIC or (shown == STATIC and state == ABSENT):
                verdicts[k] = DYNAMIC
            continue
        plane_px = np.sqrt((found[0] - by_plane[0]) ** 2 + (found[1] - by_plane[1]) ** 2)
        off_px = plane_px
        residual_px[k, 1] = plane_px
        if deep:
            residual_px[k, 0] = np.sqrt((found[0] - by_pose[0]) ** 2 + (found[1] - by_pose[1]) ** 2)
            off_px = min(residual_px[k, 0], plane_px)
        elif use_depth:
            off_px = unexplained_px(found, by_plane, T, lens, limits.nearest_m)
        # Free space is weaker evidence than a match: at outlines depth is often that of the other side.
        verdicts[k] = DYNAMIC if off_px > limits.threshold_px else STATIC
