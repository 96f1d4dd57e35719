"""How the camera moved between two images: a homography, optimally compensated, and a motion in space."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.dynamics.homography.point_motion import SHRINK
from stillroom.features.optical_flow import OpticalFlow
from stillroom.geometry import homography, se3
from stillroom.geometry.arrays import F64, I64, U8, Bool
from stillroom.geometry.camera import Camera
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
        probes = choose_probes(kp.raw_px.astype(np.float64), has_depth, ~may_move, config.n_probes, cell_px)
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
        observed_px = np.column_stack((then_px[known], np.zeros(n)))
        weights = np.tile([1.0, 1.0, 0.0], (n, 1)) / self.config.pose_sigma_px**2
        points = camera.back_project(now_px[known], depth_m[known])
        estimate = self._optimize(guess, points, observed_px, weights, camera)
        enough = estimate.n_inliers >= max(self.config.min_inliers, n // 3)
        return se3.orthonormalize(estimate.T_cam_world) if enough else None


def choose_probes(raw_px: F64, has_depth: Bool, usable: Bool, n: int, cell_px: int = CELL_PX) -> I64:
    """Return up to n of the usable points (N, 2), spread over cells, those with depth first, in rising order."""
    candidates = np.flatnonzero(usable)
    cell = (raw_px[candidates] // cell_px).astype(np.int64)
    cell_id = cell[:, 0] + 1000 * cell[:, 1]
    order = np.lexsort((~has_depth[candidates], cell_id))
    sorted_id = cell_id[order]
    first = np.searchsorted(sorted_id, sorted_id)
    rank = np.arange(len(order)) - first  # rank of each within its cell
    chosen = order[np.argsort(rank, kind="stable")[:n]]
    return np.sort(candidates[chosen])


def _follow(frame: Frame, probes: I64, now_half: U8, then_half: U8, T_then_now: F64) -> tuple[Bool, F64]:
    """Find probes (P,) in the earlier image; return which were found (P,) and where, as taken (P, 2) [px]."""
    kp, camera = frame.keypoints, frame.camera
    depth_m = kp.depth_m[probes].astype(np.float64)
    depth_m[depth_m <= 0] = np.median(depth_m[depth_m > 0]) if np.any(depth_m > 0) else 2.0
    points = se3.transform(T_then_now, camera.back_project(kp.px[probes], depth_m))
    points[:, 2] = np.maximum(points[:, 2], 0.1)
    guess_px = camera.distort(camera.project(points))
    # Pixel centres are at integers: those of a shrunk image lie between those of the whole one.
    times = camera.in_pixels(SHRINK)
    off_px = 0.5 - 0.5 / times
    now_half_px = (1.0 / times * kp.raw_px[probes] - off_px).astype(np.float32)
    start_px = (1.0 / times * guess_px - off_px).astype(np.float32)
    then_half_px, is_found = _FLOW.follow(now_half, then_half, now_half_px, start_px)
    then_raw_px = times * then_half_px.astype(np.float64) + 0.5 * (times - 1)
    inside = np.all((then_raw_px >= 0) & (then_raw_px <= (camera.width - 1, camera.height - 1)), axis=1)
    return inside & is_found, then_raw_px
