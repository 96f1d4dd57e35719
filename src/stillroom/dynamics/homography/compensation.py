"""How the camera moved between two images: a homography, optimally compensated, and a motion in space."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.dynamics.homography.point_motion import SHRINK
from stillroom.features.optical_flow import OpticalFlow
from stillroom.geometry import homography, se3
from stillroom.geometry.arrays import F32, F64, I64, U8, Bool, Floats
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import distorted
from stillroom.geometry.homography import HomographyFit
from stillroom.optimize.pose import PoseOptimizerConfig

_FLOW = OpticalFlow(window_px=13, levels=2)
CELL_PX = 40
"""Side of the cells over which probes are spread, in images 640 pixels long [px]."""


@dataclass(frozen=True)
class CompensationConfig:
    """How the camera's motion is found (PSPNet-SLAM III.B).

    Attributes:
        n_probes: Keypoints, spread over what is not potentially dynamic, that are tracked into the earlier image.
        inlier_px: Largest residual of a pair that agrees with the homography [px].
        magsac: Whether MAGSAC++ estimates it, with local refinement; else plain RANSAC, slower and with fewer
            inliers (docs/reference.md#library-measurements).
        refine: Whether Levenberg–Marquardt follows (Eq. 11): the compensated homography. If not, the plain one. It
            improves RANSAC's result much, MAGSAC's little.
        symmetric: Whether it minimises the error in both images.
        min_inliers: Pairs that the homography, and the motion, need each.
        pose_sigma_px: Standard deviation of a followed probe [px].
        pose: How the motion is found.
    """

    n_probes: int = 200
    inlier_px: float = bounded(2.0, above=0, pixels=1)
    magsac: bool = True
    refine: bool = True
    symmetric: bool = True
    min_inliers: int = 20
    pose_sigma_px: float = bounded(0.7, above=0, pixels=1)
    pose: PoseOptimizerConfig = field(default_factory=PoseOptimizerConfig)


@dataclass(frozen=True)
class CameraMotion:
    """What is known of the camera's motion.

    Attributes:
        T_then_now: Motion in space (4, 4).
        H_now_then: Homography from the earlier image to the present one (3, 3).
        fit: How it was found; None where too few pairs agreed, and it is that of a pure rotation.
        now_px, then_px: The pairs (P, 2), undistorted [px].
    """

    T_then_now: F64
    H_now_then: F64
    fit: HomographyFit | None
    now_px: F64 = field(repr=False)
    then_px: F64 = field(repr=False)


class Compensation:
    """Estimates the camera's motion from static points, independent of the initial guess."""

    def __init__(self, config: CompensationConfig, seed: int) -> None:
        """Take the seed of MAGSAC's samples."""
        self.config, self.seed = config, seed
        self._optimize = config.pose.build()

    def __call__(
        self, frame: Frame, may_move: Bool, now_half: U8, then_half: U8, T_then_now_guess: F64
    ) -> CameraMotion | None:
        """Return how the camera moved; None where too few static points were found again.

        Args:
            frame: The present frame.
            may_move: Keypoints (N,) that are left out.
            now_half, then_half: Both images at half size; see `ImageView`.
            T_then_now_guess: Where to look first (4, 4).
        """
        config, camera, kp = self.config, frame.camera, frame.keypoints
        has_depth, cell_px = kp.depth_m > 0, camera.in_pixels(CELL_PX)
        probes = choose_probes(kp.raw_px, has_depth, ~may_move, config.n_probes, cell_px)
        if len(probes) < config.min_inliers:
            return None
        followed, then_raw_px = _follow(frame, probes, now_half, then_half, T_then_now_guess)
        probes = probes[followed]
        if len(probes) < config.min_inliers:
            return None
        then_px = camera.undistort(then_raw_px[followed]).astype(np.float64)
        now_px = kp.px[probes].astype(np.float64)
        T_then_now = self._motion(now_px, kp.depth_m[probes].astype(np.float64), then_px, T_then_now_guess, camera)
        if T_then_now is None:
            return None
        fit = self.homography(then_px, now_px)
        H = homography.of_rotation(se3.inverse(T_then_now), camera.K) if fit is None else fit.H_second_first
        return CameraMotion(T_then_now, H, fit, now_px, then_px)

    def homography(self, then_px: F64, now_px: F64) -> HomographyFit | None:
        """Return the homography from the earlier to the present image of pairs (P, 2); None where few agree."""
        fit = homography.estimate(then_px, now_px, self.config.inlier_px, self.seed, self.config.magsac)
        if fit is None or fit.is_inlier.sum() < self.config.min_inliers:
            return None
        return homography.refine(fit, then_px, now_px, self.config.symmetric) if self.config.refine else fit

    def _motion(self, now_px: F64, depth_m: F64, then_px: F64, guess: F64, camera: Camera) -> F64 | None:
        known = depth_m > 0
        n = int(known.sum())
        if n < self.config.min_inliers:
            return None
        observed_px, weights = np.zeros((2, n, 3))
        observed_px[:, :2], weights[:, :2] = then_px[known], 1.0 / self.config.pose_sigma_px**2
        points = camera.back_project(now_px[known], depth_m[known])
        estimate = self._optimize(guess, points, observed_px, weights, camera)
        enough = estimate.n_inliers >= max(self.config.min_inliers, n // 3)
        return estimate.T_cam_world if enough else None


def choose_probes(raw_px: Floats, has_depth: Bool, usable: Bool, n: int, cell_px: int = CELL_PX) -> I64:
    """Return up to n of the usable points (N, 2), spread over cells, those with depth first, in rising order."""
    chosen = np.zeros(len(raw_px), dtype=np.bool_)
    if len(raw_px) > 0:
        columns, rows = (raw_px.max(axis=0) // cell_px).astype(np.int64) + 1
        choose_by_cells(raw_px, has_depth, usable, cell_px, (int(rows), int(columns)), n, chosen)
    return np.flatnonzero(chosen)


@njit(nogil=True, cache=True)
def choose_by_cells(
    raw_px: Floats, has_depth: Bool, usable: Bool, cell_px: int, shape: tuple[int, int], n: int, chosen: Bool
) -> None:
    """Mark up to n of the usable points (N, 2) in `chosen` (N,): the first of each cell, then the second of each, ….

    In a cell those with depth come first; of the last round, the cells that come first in the image.
    """
    cell, rank = np.empty(len(raw_px), dtype=np.int64), np.full(len(raw_px), -1, dtype=np.int64)
    size = np.zeros(shape[0] * shape[1], dtype=np.int64)
    for deep in (True, False):
        for i in range(len(raw_px)):
            if usable[i] and has_depth[i] == deep:
                cell[i] = int(raw_px[i, 1] / cell_px) * shape[1] + int(raw_px[i, 0] / cell_px)
                rank[i] = size[cell[i]]
                size[cell[i]] += 1
    # The last round is the one in which n is exceeded, and in it cells up to some one have a turn.
    left, last = n, 0
    while left > 0 and last < size.max():
        in_round = int(np.count_nonzero(size > last))
        if in_round > left:
            break
        left -= in_round
        last += 1
    has_turn = np.zeros(len(size), dtype=np.bool_)
    for c in range(len(size)):
        if left > 0 and size[c] > last:
            has_turn[c] = True
            left -= 1
    for i in range(len(raw_px)):
        chosen[i] = 0 <= rank[i] < last or (rank[i] == last and has_turn[cell[i]])


def _follow(frame: Frame, probes: I64, now_half: U8, then_half: U8, T_then_now: F64) -> tuple[Bool, F64]:
    """Find probes (P,) in the earlier image; return which were found (P,) and where, as taken (P, 2) [px]."""
    kp, camera = frame.keypoints, frame.camera
    now_half_px, start_px = np.empty((2, len(probes), 2), dtype=np.float32)
    times = camera.in_pixels(SHRINK)
    depth_m = kp.depth_m[probes]
    typical_m = float(np.median(depth_m[depth_m > 0])) if np.any(depth_m > 0) else 2.0
    points = kp.px[probes], kp.raw_px[probes], depth_m, typical_m
    aim(*points, T_then_now, camera.lens, times, now_half_px, start_px)
    then_half_px, is_found = _FLOW.follow(now_half, then_half, now_half_px, start_px)
    then_raw_px = times * then_half_px.astype(np.float64) + 0.5 * (times - 1)
    x, y = then_raw_px.T
    inside = (x >= 0) & (y >= 0) & (x <= camera.width - 1) & (y <= camera.height - 1)
    return inside & is_found, then_raw_px


@njit(nogil=True, cache=True)
def aim(
    px: F32,
    raw_px: F32,
    depth_m: F32,
    typical_m: float,
    T: F64,
    lens: Lens,
    times: int,
    now_half_px: F32,
    start_px: F32,
) -> None:
    """Write where points are in a shrunk image, and where an earlier one should show them, (P, 2) [px].

    Args:
        px, raw_px, depth_m: The points (P, 2), (P, 2) [px], (P,) [m].
        typical_m: The depth of those without one [m].
        T: Motion of the camera T_then_now (4, 4).
        lens: Of both images.
        times: How many times smaller they are.
        now_half_px, start_px: What is written.
    """
    # Pixel centres are at integers: those of a shrunk image lie between those of the whole one.
    half = 1.0 / times
    off_px = 0.5 - 0.5 * half
    for i in range(len(px)):
        z = float(depth_m[i]) if depth_m[i] > 0.0 else typical_m
        x, y = (float(px[i, 0]) - lens.cx) / lens.fx * z, (float(px[i, 1]) - lens.cy) / lens.fy * z
        there = max(T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3], 0.1)
        u = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / there
        v = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / there
        u, v = distorted(lens, u, v)
        start_px[i, 0], start_px[i, 1] = half * u - off_px, half * v - off_px
        now_half_px[i, 0] = np.float32(half) * raw_px[i, 0] - np.float32(off_px)
        now_half_px[i, 1] = np.float32(half) * raw_px[i, 1] - np.float32(off_px)
